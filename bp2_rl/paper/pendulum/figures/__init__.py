"""The pictures of the pendulums, a file a figure."""
