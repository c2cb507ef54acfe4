    // What both ways to sum end with: each pixel, and what is behind it.
//!repeat PART PARTS
    {
        let column = corner.x + PARTu / QUADS * (TILE / COLUMNS);
        let row = corner.y + PARTu % QUADS * 4u;
        for (var i = 0u; i < 4u; i++) {
            if (column < frame.size.x && row + i < frame.size.y) {
                let at = (row + i) * frame.size.x + column;
                let total = total_PART[i];
                var alpha = 0.0;
                var share = 0.0;      // of Σ w c in the picture
                var backdrop = 1.0;
                if (total > 0.0) {
                    let left = through_PART[i];
                    let weight = select(behind_PART[i] / total, 0.0, left < FINISHED);
                    share = 1.0 / (total + weight * left);
                    alpha = total * share;
                    backdrop = weight * select(left, 1.0, PUBLISHED) * share;
                }
//!repeat ONCE LAYERED
                layer_depths[at] = NOWHERE;
                if (total > 0.0) {
                    layer_depths[at] = min(far_PART[i] / total, limit_PART[i]);
                }
//!end
                if (PICK) {
                    let depths = bitcast<vec2u>(vec2f(red_PART[i] * share, green_PART[i]));
                    image[at] = vec4u(depths, taker_PART[i], bitcast<u32>(alpha));
                } else {
                    let color = vec3f(red_PART[i], green_PART[i], blue_PART[i]) * share;
                    image[at] = bitcast<vec4u>(vec4f(color + backdrop * frame.background.xyz, alpha));
                }
            }
        }
    }
//!end
