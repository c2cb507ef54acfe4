// Real spherical harmonics in the signs of 3DGS; tested against gsgen.contract.spec.spherical_harmonics.

//!include appearance

// Return the colour in a direction, not clamped: max() would turn NaN into a colour.
fn harmonics(own: u32, degree: u32, direction: vec3f) -> vec3f {
    let x = direction.x;
    let y = direction.y;
    let z = direction.z;
    let a = coefficients(own, 0u);
    var color = 0.28209479177387814 * a[0] + 0.5;
    if (degree >= 1u) {
        color += 0.4886025119029199 * (z * a[2] - y * a[1] - x * a[3]);
    }
    if (degree >= 2u) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        let b = coefficients(own, 1u);
        let c = coefficients(own, 2u);
        color += 1.0925484305920792 * (x * y * b[0] - y * z * b[1] - x * z * b[3]);
        color += 0.31539156525252005 * (2.0 * zz - xx - yy) * b[2];
        color += 0.5462742152960396 * (xx - yy) * c[0];
        if (degree >= 3u) {
            let d = coefficients(own, 3u);
            color -= 0.5900435899266435 * y * (3.0 * xx - yy) * c[1];
            color += 2.890611442640554 * x * y * z * c[2];
            color -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * c[3];
            color += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * d[0];
            color -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * d[1];
            color += 1.445305721320277 * z * (xx - yy) * d[2];
            color -= 0.5900435899266435 * x * (xx - 3.0 * yy) * d[3];
        }
    }
    return color;
}
