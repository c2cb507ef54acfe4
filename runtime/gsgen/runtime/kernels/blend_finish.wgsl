    // What both ways to blend end with: each pixel, and what is behind it.
//!repeat CELL CELLS
    {
//!repeat LAYER LAYERS
        {
            let reached = depth_LAYER_CELL < vec4f(NOWHERE);
//!include blend_layer
        }
//!end
        let rest = abs(through_CELL);
        let column = corner.x + CELLu / QUADS * (TILE / COLUMNS);
        let row = corner.y + CELLu % QUADS * 4u;
        for (var i = 0u; i < 4u; i++) {
            if (column < frame.size.x && row + i < frame.size.y) {
                let at = (row + i) * frame.size.x + column;
                let alpha = 1.0 - rest[i];
                if (PICK) {
                    let depths = bitcast<vec2u>(vec2f(red_CELL[i], green_CELL[i]));
                    image[at] = vec4u(depths, taker_CELL[i], bitcast<u32>(alpha));
                } else {
                    let color = vec4f(red_CELL[i], green_CELL[i], blue_CELL[i], alpha);
                    image[at] = bitcast<vec4u>(color + rest[i] * frame.background);
                }
            }
        }
    }
//!end
