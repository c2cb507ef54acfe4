// The opacity of a splat at pixels where its logarithm is `above` that of CULL_OPACITY.
//
// It is CULL_OPACITY · e^above. Software drivers compute a slower exponential for any argument. So
// POLYNOMIAL takes a polynomial of degree 5 for 2^x with x in [0, 1), with a relative error of
// 1.6e-7 and CULL_OPACITY in its coefficients, and adds the integer part to the exponent.

const TO_BINARY = 1.4426950408889634;

fn opacity(above: vec4f) -> vec4f {
    if (!POLYNOMIAL) {
        return min(CULL_OPACITY * exp(above), vec4f(MAX_ALPHA));
    }
    let binary = above * TO_BINARY;
    let whole = floor(binary);
    let x = binary - whole;
    var p = vec4f(0.0018775766705135882 * CULL_OPACITY);
    p = p * x + 0.008989340340041362 * CULL_OPACITY;
    p = p * x + 0.05582631758807206 * CULL_OPACITY;
    p = p * x + 0.24015361733005428 * CULL_OPACITY;
    p = p * x + 0.6931530731374415 * CULL_OPACITY;
    p = p * x + 0.9999999250670458 * CULL_OPACITY;
    // Adding 1.5 · 2²³ puts the integer into the low bits of a float.
    let made = bitcast<vec4f>(bitcast<vec4u>(p) + (bitcast<vec4u>(whole + 12582912.0) << vec4u(23u)));
    return select(made, vec4f(MAX_ALPHA), made > vec4f(MAX_ALPHA));
}
