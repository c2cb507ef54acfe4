            // One Gaussian into all parts of an invocation: `id`, `shape`, `weight` and `color` are its.
            let bend = 0.5 * weight.x;
//!repeat PART PARTS
            {
                let dx = nearest(x + f32(PARTu / QUADS * (TILE / COLUMNS)) - shape.x);
                let dy = y + f32(PARTu % QUADS * 4u) - shape.y;
                let above = weight.y - 0.5 * shape.z * dx * dx - (bend * dy + shape.w * dx) * dy;
                var hit = (above >= ZERO) & (dx * dx + dy * dy <= vec4f(weight.w)) & (open_PART > ZERO);
//!repeat ONCE LAYERED
                hit = hit & (vec4f(weight.z) <= limit_PART);
//!end
                if (any(hit)) {
                    let alpha = select(ZERO, factors.x * opacity(above), hit);
                    let amount = alpha * open_PART;
                    through_PART *= max(1.0 - alpha, ZERO);
                    total_PART += amount;
                    behind_PART += amount * factors.y;
//!repeat ONCE LAYERED
                    far_PART += amount * weight.z;
//!end
                    if (PICK) {
                        red_PART += amount * weight.z;
                        let more = alpha > most_PART;
                        most_PART = select(most_PART, alpha, more);
                        most_depth_PART = select(most_depth_PART, vec4f(weight.z), more);
                        most_id_PART = select(most_id_PART, vec4u(id), more);
                    } else {
                        red_PART += amount * color.x;
                        green_PART += amount * color.y;
                        blue_PART += amount * color.z;
                    }
                }
            }
//!end
