"""What every search for a layout takes, of a study, a grid or a loop: target, first layouts, stages, progress."""
