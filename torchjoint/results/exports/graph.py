"""Which things stand on, hang on, contain and touch which: a JSON that NetworkX reads."""

from __future__ import annotations

import json
from pathlib import Path

from torchjoint.results.result import Result
from torchjoint.runtime.files import write_text
from torchjoint.runtime.threads import on_cpu


@on_cpu()
def export_graph(path: Path, result: Result) -> None:
    """Writes the relations as ``networkx.node_link_graph`` reads them: nodes are the segments, edges have a kind.

    "touches" has an edge in both directions. A node has the name, number of points, centre and size of its segment.
    """
    nodes = [
        {
            "id": record.id,
            "name": result.segment_names.get(record.id, ""),
            "points": record.points,
            "center": [round(value, 4) for value in record.center],
            "size": [round(float(value), 4) for value in record.box.size],
        }
        for record in result.records()
    ]
    edges = [
        {"source": first, "target": second, "key": key, **values}
        for first, second, key, values in result.graph().to_networkx().edges(keys=True, data=True)
    ]
    whole = {"directed": True, "multigraph": True, "graph": {"units": "metres"}, "nodes": nodes, "edges": edges}
    write_text(path, json.dumps(whole, indent=1, ensure_ascii=False))
