"""Tours: stations visited in the best order, with the best configurations."""

from tominpmp.tours.planning import plan_tour
from tominpmp.tours.station import Station
from tominpmp.tours.tour import Tour, Visit

__all__ = ["Station", "Tour", "Visit", "plan_tour"]
