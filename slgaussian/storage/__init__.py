"""Content-addressed artifact store: specs, records, housekeeping, and the folder of a field."""
