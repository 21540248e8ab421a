"""A plug-in that takes another's provider name, an id twice, and ids it must not have."""

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p


class Good(Algorithm[p.Parameters]):
    """Do nothing."""

    id, name, group = "good", "Good", "measure"
    needs_project = False

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Do nothing."""
        return Result()


class Again(Good):
    """Do nothing under a name that is taken."""


class Run(Good):
    """Call itself as a command of the application."""

    id = "run"


class Silent(Good):
    id = "silent"


Silent.__doc__ = None
TAKEN = (Good,)
ALGORITHMS = (Good, Again, Run, Silent, 7)
