// Real spherical harmonics in the signs of 3DGS; tested against gsgen.contract.spherical_harmonics.
// Needs `fn coefficient(index: u32) -> vec3f`, the colour of the Gaussian's k-th function.

fn harmonics(degree: u32, direction: vec3f) -> vec3f {
    let x = direction.x;
    let y = direction.y;
    let z = direction.z;
    var color = 0.28209479177387814 * coefficient(0u);
    if (degree >= 1u) {
        color += 0.4886025119029199 * (z * coefficient(2u) - y * coefficient(1u) - x * coefficient(3u));
    }
    if (degree >= 2u) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        color += 1.0925484305920792 * (x * y * coefficient(4u) - y * z * coefficient(5u) - x * z * coefficient(7u));
        color += 0.31539156525252005 * (2.0 * zz - xx - yy) * coefficient(6u);
        color += 0.5462742152960396 * (xx - yy) * coefficient(8u);
        if (degree >= 3u) {
            color -= 0.5900435899266435 * y * (3.0 * xx - yy) * coefficient(9u);
            color += 2.890611442640554 * x * y * z * coefficient(10u);
            color -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * coefficient(11u);
            color += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * coefficient(12u);
            color -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * coefficient(13u);
            color += 1.445305721320277 * z * (xx - yy) * coefficient(14u);
            color -= 0.5900435899266435 * x * (xx - 3.0 * yy) * coefficient(15u);
        }
    }
    return max(color + 0.5, vec3f(0.0));
}
