"""What a file is, what is installed and works, what to cite, and files to begin with."""
