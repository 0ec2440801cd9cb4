"""Work in blocks: in threads or on a dask scheduler, saved until all is done."""
