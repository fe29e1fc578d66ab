"""The artifact store: content by address, its specs and records, upkeep, a field's folder."""
