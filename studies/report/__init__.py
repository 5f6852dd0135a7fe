"""The parts that the reports of all studies share. A study lists blocks: `page.py` has them, with how values are shown,
and draws them on the one page (`page.html.j2`); `charts.py` is drawn by Plotly.

Belongs here: what two reports need. What one study shows stands in its room, in `report.py`."""
