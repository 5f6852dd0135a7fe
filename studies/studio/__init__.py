"""Draw a layout in the browser and see the cloth move. Only `widgets` and `server.py` know viser."""
