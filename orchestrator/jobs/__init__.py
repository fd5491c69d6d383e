"""One command from open to close."""
