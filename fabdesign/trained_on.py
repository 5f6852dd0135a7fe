"""What of a model its corrector was trained on, as a hash: a model that was edited since is another one."""

import hashlib
import json

from fabdesign.model import Model


def central_hash(model: Model) -> str:
    """SHA-256 of the central values of a model's parameters and effects; intervals and provenance do not count."""
    central = {
        "parameters": {name: repr(float(p.factor)) for name, p in sorted(model.parameters.items())},
        "effects": [
            [effect.name, {name: repr(float(q.value)) for name, q in sorted(effect.parameters.items())}]
            for effect in model.effects
        ],
    }
    return hashlib.sha256(json.dumps(central, sort_keys=True).encode()).hexdigest()
