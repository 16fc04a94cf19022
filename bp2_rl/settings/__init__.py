"""Settings of the MDP, of the learner and of a training, and the presets' choices.

Frozen dataclasses, written whole into every run and every policy's card. Nothing in
here imports JAX or MuJoCo, so that a mistaken flag is answered at once.
"""
