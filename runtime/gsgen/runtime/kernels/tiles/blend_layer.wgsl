        // One layer into a cell: into those pixels, too, whose splats are all before it. What a
        // finished pixel has left out passes on to it, as to the background.
        {
            let last = (depth_LAYER_CELL < vec4f(NOWHERE)) & (lit_LAYER_CELL < ZERO);
            let lit = select(max(lit_LAYER_CELL, ZERO), abs(through_CELL), last);
            through_CELL *= select(vec4f(1.0), pass_LAYER_CELL, last);
            if (PICK) {
                let passed = lit * pass_LAYER_CELL;
                let halved = (lit >= vec4f(0.5)) & (passed < vec4f(0.5));
                red_CELL += (lit - passed) * depth_LAYER_CELL;
                green_CELL = select(green_CELL, depth_LAYER_CELL, halved);
            }
            lights[LAYERu * STRIDE + CELLu] = lit;
        }
