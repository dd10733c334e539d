"""Small stiffnesses made by hand."""

import numpy as np

from studies.joint_bound import free_basis
from truenewton.estimation.reciprocity.sensor_model import Places, Values, sensors_at
from truenewton.statics.layout import rings


def small_places(motion=None, *, flat=False):
    layout = rings([0.06, 0.1], [5, 9], nz=[1.0, 1.0] if flat else [0.999, 0.99])
    return Places(layout.x, layout.y, layout.nz, motion)


def random_stiffness(random, places):
    """Return a symmetric K with K R = 0, softer where it is smoother, by and large."""
    basis = free_basis(places)
    root = random.standard_normal((places.n - 3, places.n - 3))
    size = np.geomspace(1.0, 8.0, places.n - 3)
    turned = np.linalg.qr(root)[0]
    return basis @ (turned * size) @ turned.T @ basis.T


def random_values(random, n, offset=5e-4):
    return Values(
        random.normal(0.0, 0.1, n),
        random.normal(0.0, 0.02, n),
        offset * random.normal(0, 1, (2, n)),
    )


def measured(places, values, stiffness):
    """Return K_c without noise."""
    slopes = bool(values.offset.any())
    motion = sensors_at(places, values, slopes=slopes).motion
    return stiffness @ (motion * values.gain) / values.alpha[:, None]
