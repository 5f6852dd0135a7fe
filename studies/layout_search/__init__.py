"""The parts of every search for a layout, of a study, a grid or a loop: target, first layouts, stages."""
