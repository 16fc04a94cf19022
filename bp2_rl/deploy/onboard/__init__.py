"""The controller on a robot's computer, without JAX and the rest of bp2_rl.

`bp2 export` copies this folder. `computer`, `controller` and `motion` need NumPy and
onnxruntime. `rehearse` and `robot`, which try them against a simulated robot, need
mujoco as well.
Modules here import each other and the laws that a bundle copies (`LAWS` in
`bp2_rl.deploy.bundle`).
"""
