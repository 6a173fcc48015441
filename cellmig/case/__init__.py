"""The case file: schema, units, reader, checks and messages."""
