"""Models fitted to their free runs, and what effects would do to them, to first order."""
