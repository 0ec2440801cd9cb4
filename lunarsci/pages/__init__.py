"""One self-contained page of several results: what was found, how sure it is, and what it rests on."""
