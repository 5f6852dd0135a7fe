"""What nobody has measured yet: layouts and muscle types judged before they are sewn."""
