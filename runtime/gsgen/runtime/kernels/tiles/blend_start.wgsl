// What both ways to blend begin with: where the tile is, and cells with nothing in them.

    let range = ranges[tile.y * frame.tiles.x + tile.x];
    let corner = vec2u(tile.x * TILE + local.x, tile.y * TILE + local.y * 4u * QUADS);
    let x = f32(corner.x) + 0.5 - frame.origin.x;
    let y = f32(corner.y) + 0.5 - frame.origin.y + vec4f(0.0, 1.0, 2.0, 3.0);
//!repeat CELL CELLS
    var through_CELL = vec4f(1.0);
    var red_CELL = ZERO;
    var green_CELL = ZERO;
    var blue_CELL = ZERO;
    var taker_CELL = vec4u(ABSENT);
//!repeat LAYER LAYERS
    let top_LAYER_CELL = corner + vec2u(CELLu / QUADS * (TILE / COLUMNS), CELLu % QUADS * 4u);
    let depth_LAYER_CELL = depths_of_layer(LAYERu, top_LAYER_CELL);
    let pass_LAYER_CELL = 1.0 - alphas_of_layer(LAYERu, top_LAYER_CELL);
    var lit_LAYER_CELL = vec4f(-1.0);  // how much light the layer takes, once it is met
//!end
//!end
