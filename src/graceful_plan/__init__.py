"""graceful_plan: motion planning for motions along which a failure at any moment does little harm."""

from graceful_plan import lazy_imports

lazy_imports.install(__name__)
