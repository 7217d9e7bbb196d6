"""Without looking at the readings: records drawn, free runs, fits of the free run."""
