"""Identify an ARX model from arrays, by least squares and by SRIV, when the gyro is noisy; print its figures."""

import numpy as np

import mavdiag as md
from mavdiag.identify.lab import model_figures

DT = 0.01
rng = np.random.default_rng(seed=1)

# An airframe whose rate loop we know: y(t) = 1.6 y(t-1) - 0.68 y(t-2) + 0.05 u(t-1) + 0.03 u(t-2).
a, b = np.array([1.0, -1.6, 0.68]), np.array([0.0, 0.05, 0.03])
airframe = md.identify.ArxModel(a, b, DT, (2, 2, 1), md.identify.Method.PUBLISHED)
commanded = np.repeat(rng.normal(0.0, 0.5, 200), 25)  # rad/s, a new rate every 0.25 s
measured = airframe.simulate(commanded) + 0.05 * rng.standard_normal(len(commanded))

for method in ("ls", "sriv"):
    model = md.identify.fit(commanded, measured, order=(2, 2, 1), dt=DT, method=method)
    error = model.simulate(commanded) - airframe.simulate(commanded)
    pole = model_figures(model).poles[0]
    print(f"{method:>4}: a = {model.a.round(3)}, b = {model.b.round(3)}, R_T2 = {model.r2t:.4f}")
    print(f"      largest error of the simulated rate {np.abs(error).max():.4f} rad/s")
    print(f"      natural frequency {pole.natural_hz.value:.3f} +- {pole.natural_hz.standard_error:.3f} Hz")

print(model.to_control())
