"""What is published: a channel for each kind of line of the daemon, as JSON with a schema that states the units."""

from __future__ import annotations

from typing import Any

JsonSchema = dict[str, Any]

# By the `type` of a line. The greeting holds a whole status.
TOPICS = {
    "hello": "/live/status",
    "status": "/live/status",
    "estimate": "/live/estimate",
    "move": "/live/move",
    "event": "/live/event",
    "dropped": "/live/dropped",
}
LOG_TOPIC = "/live/log"


def _number(what: str) -> JsonSchema:
    return {"type": "number", "description": what}


def _text(what: str) -> JsonSchema:
    return {"type": "string", "description": what}


def _object(title: str, properties: JsonSchema) -> JsonSchema:
    return {"type": "object", "title": title, "properties": {"type": _text("kind of line"), **properties}}


_ESTIMATE: JsonSchema = {
    "t_s": _number("[s] monotonic clock of the daemon's computer"),
    "displacement_mm": _number("[mm]"),
    "sigma_mm": _number("[mm] 1-sigma of displacement"),
    "velocity_mm_s": _number("[mm/s]"),
    "segment": _text("ZUPT, VVS or CVS"),
    "can_state": _text("what the displacement sensor is thought to be"),
    "move": {"type": "integer", "description": "number of the current or last move"},
}
_PART: JsonSchema = {
    "type": "object",
    "properties": {
        "state": _text("ok, ill, waiting or off"),
        "since_s": _number("[s] since when, on the clock of t_s"),
        "what": _text("what is wrong"),
        "advice": _text("what to do"),
    },
}
_PARTS = ("imu", "jy901", "can", "displacement", "estimator", "recorder", "loop")

SCHEMAS: dict[str, JsonSchema] = {
    "/live/estimate": _object("ramstroke.Estimate", _ESTIMATE),
    "/live/status": _object(
        "ramstroke.Status",
        {
            "state": _text("of the worst part"),
            "t_s": _ESTIMATE["t_s"],
            **dict.fromkeys(_PARTS, _PART),
            "estimate": {"type": "object", "properties": _ESTIMATE},
        },
    ),
    "/live/move": _object(
        "ramstroke.Move",
        {
            "kind": _text("push or retract"),
            "onset_s": _number("[s] start of acceleration"),
            "stop_s": _number("[s] start of deceleration"),
            "start_mm": _number("[mm]"),
            "end_mm": _number("[mm]"),
            "sigma_mm": _number("[mm] 1-sigma of end_mm"),
            "end_before_stop_mm": _number("[mm] before a mechanical stop was used"),
            "sigma_before_stop_mm": _number("[mm]"),
            "velocity_mm_s": _number("[mm/s] between the bursts"),
            "can_state": _ESTIMATE["can_state"],
            "tier": _text("settled"),
        },
    ),
    "/live/event": _object("ramstroke.Event", {"t_s": _ESTIMATE["t_s"], "what": _text("in words")}),
    "/live/dropped": _object(
        "ramstroke.Dropped", {"lines": {"type": "integer", "description": "lost on the way here"}}
    ),
    # Foxglove's own type for its log panel.
    LOG_TOPIC: {
        "type": "object",
        "title": "foxglove.Log",
        "properties": {
            "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
            "level": {"type": "integer"},
            "message": {"type": "string"},
            "name": {"type": "string"},
            "file": {"type": "string"},
            "line": {"type": "integer"},
        },
    },
}
