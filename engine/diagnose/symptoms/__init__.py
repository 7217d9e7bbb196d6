"""What a free run and one-step predictions get wrong, before any cause is named."""
