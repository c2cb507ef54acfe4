// The circle that bounds a splat of a weighted sum.
//
// Its radius is rounded up to whole pixels: `reach` standard deviations along the longer axis of
// the 2D covariance, whose eigenvalues are assumed to differ by 2·√MIN_EIGENVALUE_GAP at least.

// wide: covariance xx xy yy in units of `unit` pixels²; determinant: in the same units, squared.
fn circle(wide: vec3f, determinant: f32, unit: f32, reach: f32) -> f32 {
    let middle = 0.5 * (wide.x + wide.z);
    let apart = sqrt(max(MIN_EIGENVALUE_GAP / unit / unit, middle * middle - determinant));
    return ceil(reach * sqrt((middle + apart) * unit));
}
