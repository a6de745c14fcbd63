"""What a job will take, before it runs: measured on a small part of it, counted for the rest."""
