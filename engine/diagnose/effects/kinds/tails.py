"""Heavy tails: outliers among the readings, or shocks on a state."""

from __future__ import annotations

from engine.diagnose.effects.channels import Kind, at_signals
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.effects.traits import Traits
from engine.filters.heavy_tails import with_mixture
from engine.statespace.model import MixedModel, Parameter


def _heavy_tails(setting: Setting, channel: str, name: str) -> Effect:
    at_output = channel in setting.model.outputs

    def extend(model: MixedModel) -> MixedModel:
        where = "measurement" if at_output else "dynamics"
        return with_mixture(model, where, channels=[channel], name=name)

    what = "measurement" if at_output else "process"
    return Effect(
        "heavy-tails",
        channel,
        "noise",
        f"outliers in the {what} noise of {channel}",
        f"with probability {name}_share the noise of {channel} is {name}_ratio times as large",
        (
            Parameter(f"{name}_share", 1e-6, "1", (1e-6, 0.5), "share of outliers"),
            Parameter(f"{name}_ratio", 10.0, "1", (1.0, 1e4), "their size over the usual"),
        ),
        extend,
        look_alikes={
            "pulse": "comes once",
            "variance": "comes at certain times or states",
            "relative-noise": "comes where readings are large",
        },
        one_sided=True,
        traits=Traits(outliers=True),
    )


KINDS: list[Kind] = [at_signals("heavy-tails", _heavy_tails)]
