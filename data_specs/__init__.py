"""Layout of every stored array and table: a TOML file each, read as package data."""
