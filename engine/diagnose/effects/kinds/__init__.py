"""Kinds of effects: what each adds to a model, a family a module; the catalogue lists them."""
