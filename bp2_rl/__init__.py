"""The open training stack for BP2: robot model, reference motion, MDP, learner, policy, evidence."""

__version__ = "0.1.0"
