"""Diagnosis of models on measured records, and one simulated one, whose missing effects are documented.

``records`` reads them, ``models`` are those of them that are not registered, ``runs`` diagnoses, ``known`` says
what is known, ``report`` writes it all down. The data are not part of this repository.
"""
