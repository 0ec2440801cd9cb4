"""Work in blocks: by threads, by processes, on a dask scheduler, kept until all is done."""
