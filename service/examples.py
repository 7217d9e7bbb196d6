"""Requests for the OpenAPI document; the tests post each of them."""

from __future__ import annotations

from typing import Any

_FLOWS = [1120, 1160, 963, 1210, 1160, 1160, 813, 1230, 1370, 1140, 995, 935, 1110, 994, None]
_FLOWS += [960, 1180, 799, 958, 1140, 1100, 1210, 1150, 1250, 1260, 1220, 1030, 1100, 774, 840]
_FLOWS += [874, 694, 940, 833, 701, 916, 692]

_NILE = [{"y": [[flow] for flow in _FLOWS], "dt": 1.0}]

EXAMPLES: dict[str, Any] = {
    "nile": {
        "summary": "Variances of the local-level model from Nile flows; 1885 is missing",
        "value": {
            "kind": "estimate",
            "model": "local-level",
            "series": _NILE,
            "parameters": {"start": {"q": 1000.0, "r": 10000.0}, "free": ["q", "r"]},
            "options": {"method": "quasi-newton", "particles": 50, "iterations": 30, "seed": 1},
        },
    },
    "smooth": {
        "summary": "Smoothed states of the mixed fourth-order model, irregular time stamps",
        "value": {
            "kind": "smooth",
            "model": {"name": "mixed-4"},
            "series": [
                {
                    "y": [[0.1, 0.4], [0.2, None], [0.1, 0.1], [None, None], [0.3, -0.2]],
                    "t": [0.0, 1.0, 2.0, 3.5, 4.0],
                }
            ],
            "parameters": {"values": {"theta_2": 0.9}},
            "options": {"particles": 100, "seed": 3},
        },
    },
    "diagnose": {
        "summary": "What the local-level model leaves out of the Nile flows",
        "value": {
            "kind": "diagnose",
            "model": "local-level",
            "series": _NILE,
            "options": {"effects": ["step", "pulse", "ramp", "latent"], "seed": 1},
        },
    },
    "design": {
        "summary": "The input that tells quadratic drag of an oscillator from Coulomb friction",
        "value": {
            "kind": "design",
            "model": "oscillator",
            "options": {
                "causes": {"drag:velocity": 0.2, "coulomb:velocity": 0.3},
                "bounds": {"inputs": {"drive": {"low": -1.0, "high": 1.0}}, "dt": 0.05},
                "length": 60,
                "inputs": 16,
                "seed": 1,
            },
        },
    },
    "simulate": {
        "summary": "One draw of 50 samples from the linear second-order model",
        "value": {
            "kind": "simulate",
            "model": "linear-2",
            "parameters": {"values": {"theta": 0.2}},
            "options": {"mode": "stochastic", "samples": 50, "seed": 7},
        },
    },
}
