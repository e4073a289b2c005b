"""One file for each physical effect: its law and everything that is known of it."""
