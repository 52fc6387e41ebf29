"""What proves the library: the paper's figures, the torque-speed plane, the tolerance of wrong parameters.

Imports the library, never the reverse. A figure is a file in `figures`, a target of the plane one in `plane`;
`registry` finds them. Below them: `claims` (what is claimed, by numbers), `judge` (a run on the plant's
truth), `figure` and `target` (what a file there holds), `paper` and `conditions` (the drives they run). Above
them: `reproduce` and `beyond` run them, `table` is what was measured, `documents` writes it into the
documents, `report` draws pages, `commands` is the command line.
"""
