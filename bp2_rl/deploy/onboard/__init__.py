"""What runs on the robot's computer, without JAX and without the rest of bp2_rl: `bp2 export` copies this folder.

`controller` and `motion` need NumPy and onnxruntime. `rehearse` and `robot`, which try them against a simulated robot,
need mujoco as well. Modules here import nothing of bp2_rl but each other.
"""
