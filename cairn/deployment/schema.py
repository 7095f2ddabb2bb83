"""The JSON Schema of the deployment format, for editors: deploy/deployment.schema.json.

`python -m cairn.deployment.schema FILE` writes it.
"""

import json
import sys
from pathlib import Path
from typing import Any

from cairn.deployment.model import Deployment

_REFERENCE = {"$ref": "#/$defs/Reference"}


def json_schema() -> dict[str, Any]:
    """Return the schema, in which a `${setting}` may replace every value that is not a section."""
    schema = Deployment.model_json_schema()
    for section in (schema, *schema["$defs"].values()):
        properties = section.get("properties", {})
        for name, value in properties.items():
            if value.get("type") in ("integer", "number", "boolean", "array") or "enum" in value:
                outer = {
                    key: value.pop(key)
                    for key in ("title", "description", "default") & value.keys()
                }
                properties[name] = {**outer, "anyOf": [value, _REFERENCE]}
    schema["$defs"]["Reference"] = {
        "description": "The value of a setting.",
        "pattern": r"^\$\{.+\}$",
        "type": "string",
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def schema_text() -> str:
    """Return the schema as the text of its file."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(schema_text(), encoding="utf-8")
