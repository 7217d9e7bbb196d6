"""Diagnosis of models on measured records, and one simulated one, whose missing effects are documented.

``records`` reads them, ``models`` are those of them that are not registered, ``runs`` diagnoses, ``alone``
tells what each criterion says by itself, ``by_sindy`` asks PySINDy, ``known`` says what is known. ``report``
writes it all down, with the table of ``side_by_side``. The data are not part of this repository.
"""
