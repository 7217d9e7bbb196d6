"""Does a designed experiment end in the right name? Simulated cases, diagnosed anew."""
