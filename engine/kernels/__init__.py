"""Numba kernels: arrays in, arrays out, no model inside."""
