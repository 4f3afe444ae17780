"""Tours: stations visited in the best order, with the best configurations."""

from tominpmp.cell.tours.planning import plan_tour
from tominpmp.cell.tours.station import Station, Visit
from tominpmp.cell.tours.tour import Tour

__all__ = ["Station", "Tour", "Visit", "plan_tour"]
