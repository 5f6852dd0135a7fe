"""The widgets that viser shows: panels, views and the page. Belongs here: what makes widgets or nodes of a document."""
