"""@title@ NumPy.

@convention@
"""

import numpy as np

REFERENCE_C = @t0@
INPUT_TO_MPS2 = @scale@
B0 = np.array(@b0@)
B1 = np.array(@b1@)
B2 = np.array(@b2@)
S1 = np.array(@s1@)
Q = np.array(@q@)
A = np.array(@a@)
R = np.array(@r@)
@gyroscope{
RATE_REFERENCE_C = @wt0@
RATE_INPUT_TO_RAD_S = @wscale@
RATE_B0 = np.array(@wb0@)
RATE_B1 = np.array(@wb1@)
RATE_S1 = np.array(@ws1@)
RATE_A = np.array(@wa@)
G = np.array(@wg@)
@}


def correct(output, temperature_c=REFERENCE_C):
    """Specific force, m/s^2, body axes, of outputs of shape (3,) or (n, 3), at one temperature, degrees Celsius."""
    dt = temperature_c - REFERENCE_C
    y = np.asarray(output, float) * INPUT_TO_MPS2 - (B0 + (B1 + B2 * dt) * dt)
    z = np.linalg.solve(A * (1 + np.diag(S1 * dt)), y.T).T
    return (z - Q * z * z) @ R.T
@gyroscope{


def correct_rate(output, force, temperature_c=RATE_REFERENCE_C):
    """Angular rate, rad/s, body axes, of outputs in @wunit@ of shape (3,) or (n, 3), with the specific force of correct."""
    dt = temperature_c - RATE_REFERENCE_C
    y = np.asarray(output, float) * RATE_INPUT_TO_RAD_S - (RATE_B0 + RATE_B1 * dt) - np.asarray(force) @ R @ G.T
    return np.linalg.solve(RATE_A * (1 + np.diag(RATE_S1 * dt)), y.T).T @ R.T
@}
