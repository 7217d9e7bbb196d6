"""What an extension is worth on data that it has not seen."""
