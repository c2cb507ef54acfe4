    // What both ways to blend end with: each pixel, and what is behind it.
//!repeat ONCE LAYERED
    var lights: array<vec4f, LAYERS * CELLS>;
//!end
//!repeat CELL CELLS
    {
//!repeat LAYER LAYERS
//!include blend_layer
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
//!repeat ONCE LAYERED
    if (!PICK) {
        // Reading colours takes compilers long: a loop that none of them can unroll does it.
        let pixels = select(0u, 4u * CELLS, frame.size.x > 0u);
        for (var pixel = 0u; pixel < pixels; pixel++) {
            let cell = pixel / 4u;
            let column = corner.x + cell / QUADS * (TILE / COLUMNS);
            let row = corner.y + cell % QUADS * 4u + pixel % 4u;
            if (column < frame.size.x && row < frame.size.y) {
                let at = row * frame.size.x + column;
                var color = bitcast<vec4f>(image[at]);
                for (var layer = 0u; layer < LAYERS; layer++) {
                    let shown = layers[layer * frame.size.x * frame.size.y + at];
                    color += lights[layer * STRIDE + cell][pixel % 4u] * vec4f(shown.xyz, 0.0);
                }
                image[at] = bitcast<vec4u>(color);
            }
        }
    }
//!end
