"""What nobody has measured yet: layouts and muscle types predicted before they are sewn."""
