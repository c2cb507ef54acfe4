// The opacity of a splat where it is `above` the least that is drawn: CULL_OPACITY · e^above.
//
// Drivers on CPUs work out a longer exponential, whose argument may be anything. This is 2^p(x)
// by a polynomial of degree 5 for 2^x in [0, 1), off by 1.6e-7 of itself, with CULL_OPACITY in
// its coefficients; the whole part is added to the exponent.

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
    // A float of 1.5 · 2²³ more has the whole number in its low bits.
    let made = bitcast<vec4f>(bitcast<vec4u>(p) + (bitcast<vec4u>(whole + 12582912.0) << vec4u(23u)));
    return select(made, vec4f(MAX_ALPHA), made > vec4f(MAX_ALPHA));
}
