"""The foreign benchmark: the diagnosis on models that are not ours, of data that another program made.

Nothing of the engine simulates here: the truth is differential equations with their own integrator. Read
in this order: :mod:`plant` (truth and its integrator), :mod:`faults`, :mod:`sensors` and :mod:`outside`
(what is wrong with it), :mod:`systems` (ten plants, each with the model a user would write), :mod:`units`
(the same series in other units), :mod:`cells`, :mod:`sizes`, :mod:`alike` (the same thing in other words),
:mod:`runs` (one series, one row), :mod:`report`. :mod:`dev` diagnoses a few series of other seeds.
"""
