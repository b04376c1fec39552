"""A pack as one web page that shows it in any browser (docs/sharing.md)."""
