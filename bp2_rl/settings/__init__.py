"""What may be chosen: of the MDP, of the learner, of a training; and what the presets
choose.

Frozen dataclasses, written whole into every run and every policy's card. Nothing in
here imports JAX or MuJoCo, so that a mistaken flag is answered at once.
"""
