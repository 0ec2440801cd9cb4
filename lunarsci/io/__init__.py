"""Files in and out: bytes, tables, records as JSON and CSV, and writing that leaves nothing half done."""
