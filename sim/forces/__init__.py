"""Forces of the cloth, its muscles and its contacts, each with the stiffness that the solver takes from it. Belongs
here: a law without memory, as Taichi functions."""
