"""A garage of which only some bays, chargers and homes are in use: how many it needs, without another net."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from sumo_nets.errors import NetError
from sumo_nets.graph import Role
from sumo_nets.read import GarageNet
from sumo_nets.wording import one_of


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


def chosen_homes(net: GarageNet, names: Sequence[str] | None = None) -> GarageNet:
    """The same garage with these homes alone; the others are places like any other.

    Args:
        net: a garage.
        names: homes by name, the first AGV's first; None: all, in the layout's order.

    Returns:
        The garage; itself if nothing is chosen.

    Raises:
        NetError: a name is no home of the garage, or is given twice.
    """
    if names is None:
        return net
    homes = {net.graph.names[home]: home for home in net.graph.homes}
    for name, times in Counter(names).items():
        if name not in homes:
            raise NetError(f"homes: {name}: {net.name} has no such home; {one_of(homes)}")
        if times > 1:
            raise NetError(f"homes: {name}: is there {times} times; give each home once")
    roles = {**net.graph.roles, "home": tuple(homes[name] for name in names)}
    return replace(net, graph=replace(net.graph, roles=roles))
