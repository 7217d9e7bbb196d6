"""Plasmodes: effects of known size put into real measurements, and asked of the diagnosis.

The noise is that of laboratories, and nobody knows its law; only what was put in is known. Read in this order:
:mod:`windows` (parts of the measured records, each with a model in which nothing is found any more),
:mod:`planted` (what is done to readings, or to what the record says of an input), :mod:`sizes` (how large),
:mod:`runs` (one plasmode, one row), :mod:`report`. The data are not part of this repository.
"""
