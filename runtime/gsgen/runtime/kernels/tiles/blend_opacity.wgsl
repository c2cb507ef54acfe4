// The opacity of a splat at pixels where its logarithm is `above` that of CULL_OPACITY.
//
// It is CULL_OPACITY · e^above. Software drivers compute a slower exponential for any argument. So
// POLYNOMIAL takes a polynomial of degree 5 for 2^x with x in [0, 1), with a relative error of
// 1.6e-7 and a factor in its coefficients, and adds the integer part to the exponent.

const TO_BINARY = 1.4426950408889634;

// Return factor · 2^binary, if that is neither too large nor too small for a float.
fn scaled_power(factor: f32, binary: vec2f) -> vec2f {
    let whole = floor(binary);
    let x = binary - whole;
    var p = vec2f(0.0018775766705135882 * factor);
    p = p * x + 0.008989340340041362 * factor;
    p = p * x + 0.05582631758807206 * factor;
    p = p * x + 0.24015361733005428 * factor;
    p = p * x + 0.6931530731374415 * factor;
    p = p * x + 0.9999999250670458 * factor;
    // Adding 1.5 · 2²³ puts the integer into the low bits of a float.
    return bitcast<vec2f>(bitcast<vec2u>(p) + (bitcast<vec2u>(whole + 12582912.0) << vec2u(23u)));
}

// Return opacities of at most MAX_ALPHA.
fn limited(alpha: vec4f) -> vec4f {
    return select(alpha, vec4f(MAX_ALPHA), alpha > vec4f(MAX_ALPHA));
}

fn opacity(above: vec4f) -> vec4f {
    if (!POLYNOMIAL) {
        return min(CULL_OPACITY * exp(above), vec4f(MAX_ALPHA));
    }
    let binary = above * TO_BINARY;
    return limited(vec4f(scaled_power(CULL_OPACITY, binary.xy), scaled_power(CULL_OPACITY, binary.zw)));
}
