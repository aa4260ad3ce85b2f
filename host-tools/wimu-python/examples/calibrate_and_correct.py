"""Calibrates an accelerometer and corrects it: calibrate_and_correct.py [FILE]

FILE is a recording of a sensor at rest in a dozen orientations. Without it, a sensor with a bias of 0.3 m/s² and a scale
factor error of 2 % is simulated.
"""

import sys

import numpy as np
import wimu

GRAVITY = 9.80665


def simulated(poses=14):
    """A recording of 3 s at rest in each pose, 100 Hz, with motion between the poses."""
    random = np.random.default_rng(1)
    # A spiral on the sphere.
    z = 1.0 - 2.0 * (np.arange(poses) + 0.5) / poses
    around, angle = np.sqrt(1.0 - z**2), 2.4 * np.arange(poses)
    force = []
    for up in GRAVITY * np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1):
        force.append(up + random.normal(scale=0.02, size=(300, 3)))
        force.append(up + random.normal(scale=4.0, size=(50, 3)))
    output = 1.02 * np.concatenate(force) + [0.3, -0.2, 0.1]
    return wimu.Recording(np.arange(len(output)) * 0.01, output, name="simulated")


def at_rest(force):
    """Means of |f| − g, m/s², over the parts of 100 samples that are at rest."""
    parts = force[: len(force) // 100 * 100].reshape(-1, 100, 3)
    still = parts.std(axis=1).max(axis=1) < 0.1
    return np.linalg.norm(parts[still].mean(axis=1), axis=1) - GRAVITY


def main():
    recording = wimu.read(sys.argv[1]) if len(sys.argv) > 1 else simulated()
    for track in recording.tracks:
        print(f"{track.quantity}: {len(track)} rows, {track.unit}")
    try:
        calibration = wimu.calibrate(recording)
    except wimu.WimuError as error:
        sys.exit(f"{error.code}: {error.message}\n{error.remedy}")
    for axis, bias, sd in zip("XYZ", calibration.bias, calibration.bias_sd):
        print(f"bias {axis} {bias:+.4f} ± {sd:.4f} m/s²")
    calibration.save("CAL.json")
    corrected = wimu.apply(calibration, recording)
    track = next(track for track in recording.tracks if track.quantity == "specific force")
    scale = GRAVITY / calibration.sensitivity if track.unit == "LSB" else 1.0
    for name, force in (("before", scale * track.values[track.valid]), ("after", corrected.specific_force)):
        rms = np.sqrt(np.mean(at_rest(force) ** 2))
        print(f"|f| − g at rest, {name} correction: {1e3 * rms:.1f} mm/s² rms")


if __name__ == "__main__":
    main()
