// The circle around a splat outside of which weighted sums leave it out.
//
// Its radius is a whole number of pixels: `reach` standard deviations along the longer axis of the
// 2D covariance, whose eigenvalues are assumed to differ by 2·√MIN_EIGENVALUE_GAP at least, rounded up.

// wide: xx xy yy of the covariance in units of `unit` pixels²; determinant: of it in those units.
fn circle(wide: vec3f, determinant: f32, unit: f32, reach: f32) -> f32 {
    let middle = 0.5 * (wide.x + wide.z);
    let apart = sqrt(max(MIN_EIGENVALUE_GAP / unit / unit, middle * middle - determinant));
    return ceil(reach * sqrt((middle + apart) * unit));
}
