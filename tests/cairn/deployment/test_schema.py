"""The published JSON Schema is current, and agrees with the accepted documents."""

from pathlib import Path

from cairn.deployment.schema import json_schema, schema_text

PUBLISHED = Path(__file__).parents[3] / "deploy" / "deployment.schema.json"


def test_published_schema_is_current() -> None:
    assert PUBLISHED.read_text(encoding="utf-8") == schema_text(), (
        "regenerate it: python -m cairn.deployment.schema deploy/deployment.schema.json"
    )


def test_every_key_is_described_and_unknown_keys_are_rejected() -> None:
    schema = json_schema()

    for section in (schema, *schema["$defs"].values()):
        if section["type"] == "object":
            assert section["additionalProperties"] is False
            for name, value in section["properties"].items():
                assert value.get("description"), name


def test_setting_may_replace_any_value_that_is_not_a_section() -> None:
    component = json_schema()["$defs"]["ChildSpec"]["properties"]

    reference = {"$ref": "#/$defs/Reference"}
    for name in ("start_timeout_s", "restart", "significant"):
        assert reference in component[name]["anyOf"]
    assert "anyOf" not in component["parameters"]
