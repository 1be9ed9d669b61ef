"""The local page for engineers who do not type: `hsed app`."""
