// What both ways to sum begin with: where the tile is, and pixels with nothing in them.

    let range = ranges[tile.y * frame.tiles.x + tile.x];
    let corner = vec2u(tile.x * TILE + local.x, tile.y * TILE + local.y * 4u * QUADS);
    let middle = vec2f(tile.xy * TILE) + 0.5 * f32(TILE) - frame.origin;
    let x = f32(corner.x) + 0.5 - frame.origin.x;
    let y = f32(corner.y) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);
//!repeat PART PARTS
    var through_PART = vec4f(1.0);
    var open_PART = vec4f(1.0);
    var total_PART = ZERO;
    var behind_PART = ZERO;
    var red_PART = ZERO;
    var green_PART = ZERO;
    var blue_PART = ZERO;
    var taker_PART = vec4u(ABSENT);
    var most_PART = ZERO;
    var most_depth_PART = ZERO;
    var most_id_PART = vec4u(ABSENT);
//!repeat ONCE LAYERED
    let limit_PART = limits(corner + vec2u(PARTu / QUADS * (TILE / COLUMNS), PARTu % QUADS * 4u));
    var far_PART = ZERO;
//!end
//!end
