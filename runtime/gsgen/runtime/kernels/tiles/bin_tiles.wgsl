// Bin: list the tiles that each splat touches, nearest splat first.

//!include runs
//!include splat_record
//!include tile_span
//!include words

@group(0) @binding(7) var<storage, read> shapes: array<Quad>;
@group(0) @binding(8) var<storage, read> weights: array<Quad>;

@compute @workgroup_size(THREADS)
fn emit(@builtin(global_invocation_id) invocation: vec3u) {
    let run = run_of(invocation.x);
    var pair = run.pair;
    for (var rank = run.first; rank < run.end; rank++) {
        let id = order[rank];
        let shape = vector_of(shapes[shape_at(id)]);
        let weight = vector_of(weights[weight_at(id)]);
        let ellipse = outline(shape.xy, vec3f(shape.zw, weight.x), weight.y, weight.w);
        for (var row = ellipse.rows.x; row < ellipse.rows.y; row++) {
            var listed = 0u;  // an earlier copy has listed the columns before this one
            for (var copy = FIRST_COPY; copy < FIRST_COPY + COPIES; copy++) {
                let tiles = span(ellipse, row, copy);
                pair = list_tiles(id, row, max(tiles.x, listed), tiles.y, pair);
                listed = max(tiles.y, listed);
            }
        }
    }
}
