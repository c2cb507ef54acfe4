                    // One layer into those pixels of a cell that have `reached` it, once. What a
                    // finished pixel has left out passes on to it, as to the background.
                    for (var i = 0u; i < 4u; i++) {
                        if (reached[i]) {
                            let line = LAYERu * frame.size.y + top_LAYER_CELL.y + i;
                            let layer = layers[line * frame.size.x + top_LAYER_CELL.x];
                            let rest = abs(through_CELL[i]);
                            let passed = rest * (1.0 - layer.a);
                            if (PICK) {
                                red_CELL[i] += rest * layer.a * depth_LAYER_CELL[i];
                                if (rest >= 0.5 && passed < 0.5) {
                                    green_CELL[i] = depth_LAYER_CELL[i];
                                }
                            } else {
                                red_CELL[i] += rest * layer.x;
                                green_CELL[i] += rest * layer.y;
                                blue_CELL[i] += rest * layer.z;
                            }
                            through_CELL[i] *= 1.0 - layer.a;
                            depth_LAYER_CELL[i] = NOWHERE;
                        }
                    }
