"""Identification of a robot's motors from recordings of the real robot."""
