"""The files of chains: what is written while they grow, and is whole at any moment."""
