"""The control API's schema (OpenAPI 3.1), made from its table of operations."""

from __future__ import annotations

from typing import Any

import msgspec

from groundstation import __version__
from groundstation.service.answers import HealthStatus
from groundstation.service.api import Operation

_REFUSALS = {
    "400": "Refused; the text says why",
    "403": "The token is not in force",
    "409": "Another client has it",
    "413": "The request is too large",
    "429": "Too many requests",
}
_ERROR = {
    "type": "object",
    "properties": {"error": {"type": "string"}},
    "required": ["error"],
}


def openapi(operations: list[Operation]) -> dict[str, Any]:
    """The whole document. Requests are validated by the same types that it is made from."""
    kinds = [HealthStatus, *(operation.answer for operation in operations)]
    kinds += [operation.body for operation in operations if operation.body is not None]
    schemas, components = msgspec.json.schema_components(
        kinds, ref_template="#/components/schemas/{name}"
    )
    healthy, *rest = schemas
    answers, bodies = rest[: len(operations)], iter(rest[len(operations) :])
    paths: dict[str, Any] = {}
    for operation, answer in zip(operations, answers, strict=True):
        described: dict[str, Any] = {
            "summary": operation.summary,
            "responses": {
                "200": {"description": "Done", "content": _json(answer)},
                **{
                    status: {"description": text, "content": _json(_ERROR)}
                    for status, text in _REFUSALS.items()
                },
            },
        }
        if operation.body is not None:
            described["requestBody"] = {"required": True, "content": _json(next(bodies))}
        paths.setdefault(operation.path, {})[operation.method.lower()] = described
    health = {
        "200": {"description": "Healthy", "content": _json(healthy)},
        "503": {"description": "Not healthy, and why", "content": _json(healthy)},
    }
    paths["/health"] = {"get": {"summary": "Whether all is well", "responses": health}}
    paths["/metrics"] = {"get": _text("Figures for Prometheus", "text/plain")}
    stream = _text("Live telemetry as server-sent events", "text/event-stream")
    stream["parameters"] = [
        {
            "name": "rows_hz",
            "in": "query",
            "description": "About so many rows a second, the newest among them; else all",
            "schema": {"type": "number", "minimum": 1},
        }
    ]
    paths["/stream"] = {"get": stream}
    paths["/openapi.json"] = {
        "get": {
            "summary": "This document",
            "responses": {"200": {"description": "It", "content": _json({"type": "object"})}},
        }
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "groundstation control API", "version": __version__},
        "paths": paths,
        "components": {"schemas": components},
    }


def _json(schema: dict[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _text(summary: str, kind: str) -> dict[str, Any]:
    content = {kind: {"schema": {"type": "string"}}}
    return {"summary": summary, "responses": {"200": {"description": "Text", "content": content}}}
