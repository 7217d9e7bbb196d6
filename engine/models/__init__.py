"""The models that come with the engine, one per file."""

from engine.models import linear_2, local_level, mixed_4, oscillator, servo, structure, tanks

SHIPPED = (
    linear_2.MODEL,
    mixed_4.MODEL,
    local_level.MODEL,
    oscillator.MODEL,
    servo.MODEL,
    structure.MODEL,
    tanks.MODEL,
)
