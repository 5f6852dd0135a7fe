"""Draw a layout in the browser and see the cloth move. Only views, panels, page and server know viser."""
