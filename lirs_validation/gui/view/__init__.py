"""What a page shows, and its controls; viser alone is spoken to here."""
