"""What every command shares: options, reports, tables, exit codes."""
