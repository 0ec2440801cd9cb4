"""Small tables with units in their headers; `sources.toml` says where each of their numbers comes from."""
