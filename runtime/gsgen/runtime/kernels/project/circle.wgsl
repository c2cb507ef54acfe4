// The circle around a splat that the method of weighted sums does not look beyond.
//
// Its radius is a whole number of pixels: `reach` standard deviations along the longer axis of the
// 2D covariance, whose eigenvalues are taken to be apart by 0.1 pixels² at least, rounded up.

// wide: xx xy yy of the covariance in units of `unit` pixels²; determinant: of it in those units.
fn circle(wide: vec3f, determinant: f32, unit: f32, reach: f32) -> f32 {
    let middle = 0.5 * (wide.x + wide.z);
    let apart = sqrt(max(LEAST_APART / unit / unit, middle * middle - determinant));
    return ceil(reach * sqrt((middle + apart) * unit));
}
