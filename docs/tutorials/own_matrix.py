"""A matrix of 144 actuators as another program might have written it."""

import numpy as np

import truenewton as tn

truth = tn.static_bench(tn.mirrors.ring(144), seed=1).truth
layout = truth.layout
rng = np.random.default_rng(1)

dead = np.array([40, 41, 130])  # rows, from 0: switched off, the glass moves freely there
on = np.setdiff1d(np.arange(layout.n), dead)
k = truth.stiffness
beside = np.linalg.solve(k[np.ix_(dead, dead)], k[np.ix_(dead, on)])
core = k[np.ix_(on, on)] - k[np.ix_(on, dead)] @ beside

matrix = np.zeros_like(k)
matrix[np.ix_(on, on)] = -core / truth.alpha[on, None]  # commanded; the electronics' sign
matrix *= 1 + 1e-4 * rng.standard_normal(matrix.shape)  # and measured
matrix[:, 90] *= 1.4  # a sensor that reads too little
np.savetxt("ff.csv", matrix, delimiter=",")
places = 1e3 * np.stack([layout.x, layout.y], axis=1)
np.savetxt("where.txt", places, header="x [mm]  y [mm]")
