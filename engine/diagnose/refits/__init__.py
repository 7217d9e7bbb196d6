"""Effects estimated together with the model: one after another, compared, ranked, calibrated, kept."""
