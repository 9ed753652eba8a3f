"""A garage of which only the first bays and chargers are in use: how many it needs, without another net."""

from __future__ import annotations

from dataclasses import replace

from sumo_nets.errors import NetError
from sumo_nets.graph import Role
from sumo_nets.read import GarageNet


def first_places(net: GarageNet, bays: int | None = None, chargers: int | None = None) -> GarageNet:
    """The same garage with fewer bays and chargers; the others are lanes that lead nowhere.

    Args:
        net: a garage.
        bays: bays in use, the first ones in the layout's order; None: all.
        chargers: chargers in use, the same way.

    Returns:
        The garage; itself if nothing is left out.

    Raises:
        NetError: it has fewer than that, or hands cars over at the AGVs' homes, of which there is one for each.
    """
    if bays is not None and net.handover == "home":
        raise NetError(f"bays: {bays}: {net.name} has none: it hands cars over at the AGVs' homes")
    asked: dict[Role, int | None] = {"bay": bays, "charger": chargers}
    kept = {role: number for role, number in asked.items() if number is not None}
    if not kept:
        return net
    graph = net.graph
    for role, number in kept.items():
        if number > len(graph.roles[role]):
            raise NetError(f"{role}s: {number}: {net.name} has {len(graph.roles[role])}, give at most that many")
    roles = {**graph.roles, **{role: graph.roles[role][:number] for role, number in kept.items()}}
    used = replace(graph, roles=roles)
    sites = {bay: net.bay_sites[bay] for bay in used.bays if bay in net.bay_sites}
    return replace(net, graph=used, bay_sites=sites)
