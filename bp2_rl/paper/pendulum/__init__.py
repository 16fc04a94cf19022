"""Huygens' pendulums: what hangs from one beam and moves it (paper, "Huygens' coupled
pendulum")."""
