"""Rotates spherical harmonics up to degree 4, so that colours rotate with the splats."""

import math

import numpy as np
from jaxtyping import Float, Float32, Float64

from gsgen.formats.shared.splats import SH_COUNTS

_DIRECTION_COUNT = 200


def rotate_sh(
    sh: Float32[np.ndarray, "n k 3"], rotation: Float[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "n k 3"]:
    """Rotate SH coefficients: the result seen along R d has the colour of ``sh`` along d.

    Each degree is rotated by its own matrix (Wigner's D), the exact least-squares solution for
    the values along more directions than the matrix has rows.
    """
    degree = SH_COUNTS.index(sh.shape[1])
    directions = _directions()
    basis, rotated_basis = (
        sh_basis(directions, degree),
        sh_basis(directions @ np.asarray(rotation).T, degree),
    )
    rotated = sh.copy()
    for band in range(1, degree + 1):
        part = slice(band * band, (band + 1) * (band + 1))
        band_rotation, *_ = np.linalg.lstsq(rotated_basis[:, part], basis[:, part], rcond=None)
        rotated[:, part] = np.einsum("lk,nkc->nlc", band_rotation, sh[:, part])
    return rotated


def _directions() -> Float64[np.ndarray, "d 3"]:
    """Return unit directions evenly spread over the sphere, on a golden-angle spiral."""
    steps = np.arange(_DIRECTION_COUNT) + 0.5
    z = 1 - 2 * steps / _DIRECTION_COUNT
    azimuths = math.pi * (3 - math.sqrt(5)) * steps
    ring_radius = np.sqrt(1 - z * z)
    return np.column_stack([ring_radius * np.cos(azimuths), ring_radius * np.sin(azimuths), z])


def sh_basis(directions: Float[np.ndarray, "d 3"], degree: int) -> Float64[np.ndarray, "d k"]:
    """Evaluate the real spherical harmonics of 3DGS along unit ``directions``.

    Y_lm = (−1)^m √(2 (2l+1)/4π · (l−|m|)!/(l+|m|)!) P_l^|m|(z) times cos mφ for m > 0, or
    sin |m|φ for m < 0, with P without the Condon-Shortley phase (Ramamoorthi & Hanrahan 2001,
    equation 3, times (−1)^m).
    """
    x, y, z = np.asarray(directions, np.float64).T
    # (x + iy)^m = (ring e^iφ)^m, and P_l^m / ring^m is a polynomial of z.
    azimuth_powers = [(x + 1j * y) ** m for m in range(degree + 1)]
    basis = np.empty((len(z), SH_COUNTS[degree]))
    for band in range(degree + 1):
        for order in range(-band, band + 1):
            m = abs(order)
            ratio = math.factorial(band - m) / math.factorial(band + m)
            norm = math.sqrt((2 if m else 1) * (2 * band + 1) / (4 * math.pi) * ratio)
            angle = azimuth_powers[m].imag if order < 0 else azimuth_powers[m].real
            column = band * band + band + order
            basis[:, column] = (-1) ** m * norm * _legendre_value(band, m, z) * angle
    return basis


def _legendre_value(band: int, m: int, z: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, " d"]:
    """Return P_l^m(z) / (1 − z²)^(m/2) of associated Legendre functions, by recurrence in l."""
    previous_term = np.zeros_like(z)
    legendre_term = np.full_like(z, float(math.prod(range(1, 2 * m, 2))))
    for step in range(m + 1, band + 1):
        next_value = ((2 * step - 1) * z * legendre_term - (step + m - 1) * previous_term) / (
            step - m
        )
        previous_term, legendre_term = legendre_term, next_value
    return legendre_term
