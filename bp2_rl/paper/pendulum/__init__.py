"""Huygens' coupled pendulums, which hang from one beam and move it (paper, "Huygens'
coupled pendulum")."""
