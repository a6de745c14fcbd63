"""Mock data, with or without effects in them."""
