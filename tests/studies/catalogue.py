"""Every study by name."""

from __future__ import annotations

from tests.studies import (
    e_steps,
    estimates,
    free_run_clean,
    lost,
    poster,
    sindy,
    states,
    table_ii,
    table_ii_variants,
    uncertainty,
)
from tests.studies.blind.report import BLIND
from tests.studies.design.report import STUDY as DESIGN
from tests.studies.foreign.report import FOREIGN, FOREIGN_DEVELOPMENT
from tests.studies.measured.report import MEASURED
from tests.studies.plasmodes.report import PLASMODES
from tests.studies.study import Study

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        states.TABLES_1_2,
        states.TABLES_3_4,
        estimates.TABLE_I,
        estimates.FIGURE_1,
        lost.FIGURE_1_SMALL,
        table_ii.TABLE_II,
        table_ii_variants.TABLE_II_TRIED,
        lost.LOST_RUNS,
        poster.POSTER_LINEAR,
        poster.POSTER_NONLINEAR,
        uncertainty.STANDARD_ERRORS,
        e_steps.STUDY,
        MEASURED,
        PLASMODES,
        free_run_clean.FREE_RUN_CLEAN,
        BLIND,
        FOREIGN,
        FOREIGN_DEVELOPMENT,
        sindy.SINDY,
        DESIGN,
    )
}
# not asked for by ``all``
BESIDE = (
    "table-II-tried",
    "e-steps",
    "measured",
    "plasmodes",
    "free-run-clean",
    "blind",
    "foreign",
    "foreign-dev",
    "sindy",
    "design",
)
DOCUMENTS = tuple(name for name in STUDIES if name not in BESIDE)
ALIASES = {
    "table-1": "table-1-2",
    "table-2": "table-1-2",
    "table-3": "table-3-4",
    "table-4": "table-3-4",
}
