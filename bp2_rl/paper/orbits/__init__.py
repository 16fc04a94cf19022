"""How a motion repeats itself: sections, spectra, return maps. Arrays in, numbers out;
it knows of no robot."""
