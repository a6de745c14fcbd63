"""What a notebook or a script may do; the commands are users of it."""
