"""Write a recording of BP2's predecessor as a log for `bp2 identify`.

    python docs/real_recording.py RECORDING.npz LOG.npz

The recording has the arrays time, q, q_target, qd, up_body, omega_body, joint_names,
phase_sin_cos (of the gait's clock), and the swing of each leg: the phase at which it
begins, swing_start_phase, and its length, swing_rows.
"""

import sys

import numpy as np


def airborne(phase: np.ndarray, starts: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return whether each leg swings, (rows, 4), from the phase of the gait, 0 to 1."""
    swings = np.zeros((len(phase), 4), bool)
    for leg, (start, length) in enumerate(zip(starts, rows, strict=True)):
        since = (phase - start) % 1.0
        for begin in np.flatnonzero((since < 0.5) & (np.roll(since, 1) >= 0.5)):
            swings[begin : begin + length, leg] = True
    return swings


def main(recording: str, log: str) -> None:
    """Read a recording, and write its rows as a log."""
    with np.load(recording) as rows:
        sine, cosine = rows["phase_sin_cos"].T
        phase = np.arctan2(sine, cosine) / (2.0 * np.pi) % 1.0
        swings = airborne(phase, rows["swing_start_phase"], rows["swing_rows"])
        kept = {name: rows[name] for name in ("time", "q", "q_target", "qd")}
        np.savez(
            log,
            joint_names=rows["joint_names"],
            up=rows["up_body"],
            omega=rows["omega_body"],
            contact=~swings,
            **kept,
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
