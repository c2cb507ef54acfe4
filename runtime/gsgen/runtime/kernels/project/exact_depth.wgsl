// Exact depth: the depth of a centre as the sum of two floats.
//
// Of a million centres, many differ by less than the last bit of a float. So rounding errors are
// kept by the dot product of Ogita, Rump and Oishi 2005 ("Accurate sum and dot product"), with
// Knuth's sum of two numbers and Dekker's product. The remaining error is about 2⁻⁴⁶ of the
// distance.
//
// WGSL lets compilers simplify (a + b) − a to b, and round a · b + c only once. To prevent that,
// the operands of such steps are `hidden`: a XOR with page.zero, whose value no compiler knows,
// leaves them unchanged.

//!include page

fn hidden(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ page.zero);
}

fn hidden_each(x: vec3f) -> vec3f {
    return bitcast<vec3f>(bitcast<vec3u>(x) ^ vec3u(page.zero));
}

// Return the rounded sum of two numbers, and the rounding error.
fn exact_sum(a: f32, b: f32) -> vec2f {
    let sum = hidden(a + b);
    let part = hidden(sum - a);
    return vec2f(sum, (a - hidden(sum - part)) + (b - part));
}

// Return the twelve leading bits of each number; the remainder has twelve bits, too.
fn leading(x: vec3f) -> vec3f {
    return bitcast<vec3f>(bitcast<vec3u>(x) & vec3u(0xfffff000u));
}

// Return the error of rounding a · b to `product`: the four products of their halves are exact.
fn product_rest(a: vec3f, b: vec3f, product: vec3f) -> vec3f {
    let a_high = leading(a);
    let b_high = leading(b);
    let a_low = hidden_each(a - a_high);
    let b_low = hidden_each(b - b_high);
    return (((a_high * b_high - product) + a_high * b_low) + a_low * b_high) + a_low * b_low;
}

// Return the sum of three numbers and of a small remainder, as two floats.
fn exact_total(large: vec3f, small: f32) -> vec2f {
    let two = exact_sum(large.x, large.y);
    let three = exact_sum(two.x, large.z);
    return exact_sum(three.x, (two.y + three.y) + small);
}

struct Offset {
    high: vec3f,  // of a position from eye.at
    low: vec3f,
}

fn exact_offset(position: vec3f) -> Offset {
    let high = hidden_each(position - eye.at);
    let part = hidden_each(high - position);
    return Offset(high, (position - hidden_each(high - part)) - (eye.at + part));
}

// Return one coordinate in camera space as two floats.
fn exact_coordinate(row: vec3f, row_rest: vec3f, from_eye: Offset, eye_at: vec2f) -> vec2f {
    let products = hidden_each(row * from_eye.high);
    let small = product_rest(row, from_eye.high, products) + row * from_eye.low + row_rest * from_eye.high;
    let total = exact_total(products, (small.x + small.y) + small.z);
    let moved = exact_sum(total.x, eye_at.x);
    return exact_sum(moved.x, moved.y + (total.y + eye_at.y));
}

// Return the length of a vector of three coordinates that are sums of two floats.
fn exact_length(x: vec2f, y: vec2f, z: vec2f) -> vec2f {
    let largest = max(max(abs(x.x), abs(y.x)), abs(z.x));
    let unit = bitcast<u32>(largest) & 0x7f800000u;  // a power of two, so that no square overflows
    let shrink = bitcast<f32>((254u << 23u) - unit);
    let high = vec3f(x.x, y.x, z.x) * shrink;
    let low = vec3f(x.y, y.y, z.y) * shrink;
    let squares = hidden_each(high * high);
    let small = product_rest(high, high, squares) + 2.0 * high * low;
    let total = exact_total(squares, (small.x + small.y) + small.z);
    // One step of Newton's method: the remainder of the square, over twice the root.
    let root = hidden(sqrt(total.x));
    let square = hidden(root * root);
    let square_rest = product_rest(vec3f(root), vec3f(root), vec3f(square)).x;
    let left = ((total.x - square) - square_rest) + total.y;
    return exact_sum(root, left / (2.0 * root)) * bitcast<f32>(unit);
}

// Return the depth of a centre as two floats; after an overflow, `rounded` and 0.
fn exact_depth(position: vec3f, rounded: f32) -> vec2f {
    let from_eye = exact_offset(position);
    let rows = transpose(page.linear);
    let rests = transpose(page.linear_rest);
    var depth = exact_coordinate(rows[2], rests[2], from_eye, vec2f(eye.camera.z, eye.camera_rest.z));
    if (PANORAMA || FISHEYE) {
        let x = exact_coordinate(rows[0], rests[0], from_eye, vec2f(eye.camera.x, eye.camera_rest.x));
        let y = exact_coordinate(rows[1], rests[1], from_eye, vec2f(eye.camera.y, eye.camera_rest.y));
        depth = exact_length(x, y, depth);
    }
    return select(vec2f(rounded, 0.0), depth, abs(depth.y) <= 1e-6 * abs(depth.x));
}

// Return the bits of a depth remainder, changed so that they sort as the remainder does.
fn order_of(low: f32) -> u32 {
    let bits = bitcast<u32>(low);
    let ordered = select(bits ^ 0x80000000u, ~bits, low < 0.0);
    return select(ordered, 0x80000000u, low == 0.0);
}
