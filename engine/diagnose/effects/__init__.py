"""What a model may leave out: one file per place where it enters, and the catalogue of all."""
