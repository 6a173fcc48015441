"""The case file: units, schema, messages."""
