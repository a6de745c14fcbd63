"""Effects that change what the data weigh; one a module."""
