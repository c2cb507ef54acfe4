        // One splat into all cells of an invocation: `id`, `shape`, `weight` and `color` are its,
        // and where it is MASKED `cells` tells by a bit each which ones it touches.
        // Drivers keep an array of cells in memory, so `repeat` writes them out.
        let bend = 0.5 * weight.x;
//!repeat CELL CELLS
        {
            if (!MASKED || (cells & (1u << CELLu)) != 0u) {
                let dx = nearest(x + f32(CELLu / QUADS * (TILE / COLUMNS)) - shape.x);
                let dy = y + f32(CELLu % QUADS * 4u) - shape.y;
                let above = weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
                if (MASKED || any(above >= ZERO)) {
//!repeat LAYER LAYERS
                    // A layer that is met takes its light; blend_layer.wgsl gives it colours.
                    let met_LAYER = (vec4f(weight.z) > depth_LAYER_CELL) & (lit_LAYER_CELL < ZERO);
                    lit_LAYER_CELL = select(lit_LAYER_CELL, abs(through_CELL), met_LAYER);
                    through_CELL *= select(vec4f(1.0), pass_LAYER_CELL, met_LAYER);
//!end
                    let before = select(ZERO, through_CELL, through_CELL > ZERO);
                    let alpha = select(ZERO, opacity(above), above >= ZERO);
                    let share = alpha * before;
                    let after = before - share;
                    let enough = after > vec4f(MIN_TRANSMITTANCE);
                    let amount = select(ZERO, share, enough);
                    if (PICK) {
                        red_CELL += amount * weight.z;
                        let halved = (before >= vec4f(0.5)) & (after < vec4f(0.5));
                        green_CELL = select(green_CELL, vec4f(weight.z), halved);
                        taker_CELL = select(taker_CELL, vec4u(id), halved);
                    } else {
                        red_CELL += amount * color.x;
                        green_CELL += amount * color.y;
                        blue_CELL += amount * color.z;
                    }
                    through_CELL = select(-abs(through_CELL), after, enough);
                }
            }
        }
//!end
