"""A CiA 402 drive on the packages `canopen` and `python-can`: a peer that shares no code with the product.

usage: node.py INTERFACE NODE. It follows its targets at once, prints `ready`, and on a line from standard
input prints what it saw as one JSON object and ends.
"""
import json
import struct
import sys
import time

import canopen
import od

INTERFACE, NODE = sys.argv[1], int(sys.argv[2])
seen = {"states": ["SWITCH ON DISABLED"], "syncs": 0, "targets": 0, "max_target": 0, "min_target": 0, "host_heartbeats": 0,
        "velocity_mismatch": 0.0, "largest_speed": 0, "rpdo_deadline_ms": None, "heartbeat_consumer": None,
        "abort_option": None, "mode": None, "worst_heartbeat_gap_ms": 0.0}
# The last two targets with the times of their SYNCs: a cycle that came late is no jump.
past = []
state = {"word": 0x40, "position": 0, "target": 0, "velocity": 0, "control": 0, "last_heartbeat": None}

# Transitions of CiA 402-2 by (status pattern, test of the controlword).
NAMES = {0x40: "SWITCH ON DISABLED", 0x31: "READY TO SWITCH ON", 0x33: "SWITCHED ON",
         0x37: "OPERATION ENABLED", 0x17: "QUICK STOP ACTIVE"}


def next_word(word, control):
    off = control & 0x02 == 0
    quick = control & 0x06 == 0x02
    shutdown = control & 0x07 == 0x06
    on = control & 0x0F == 0x07
    enable = control & 0x0F == 0x0F
    if word == 0x40:
        return 0x31 if shutdown else 0x40
    if off:
        return 0x40
    if word == 0x31:
        return 0x33 if on else 0x31
    if word == 0x33:
        return 0x37 if enable else 0x31 if shutdown else 0x33
    if word == 0x37:
        return 0x17 if quick else 0x31 if shutdown else 0x33 if on else 0x37
    return word


def on_sync(_id, _data, stamp):
    seen["syncs"] += 1
    state["control"] = node.rpdo[1][0x6040].raw
    target, velocity = node.rpdo[1][0x607A].raw, node.rpdo[2][0x60B1].raw
    word = next_word(state["word"], state["control"])
    if word != state["word"]:
        seen["states"].append(NAMES[word])
        state["word"] = word
    if word == 0x37:
        past.append((stamp, target))
        if len(past) > 2:
            earlier, from_target = past.pop(0)
            seen["largest_speed"] = max(seen["largest_speed"], abs(target - from_target) / max(stamp - earlier, 0.02))
        seen["targets"] += 1
        seen["max_target"], seen["min_target"] = max(seen["max_target"], target), min(seen["min_target"], target)
        state["target"], state["velocity"], state["position"] = target, velocity, target
    node.tpdo[1][0x6041].raw = state["word"]
    node.tpdo[1][0x6064].raw = state["position"]
    node.tpdo[2][0x60F4].raw = 0
    node.tpdo[2][0x606C].raw = state["velocity"] if state["word"] == 0x37 else 0
    node.tpdo[1].transmit()
    node.tpdo[2].transmit()


def on_heartbeat(_id, _data, stamp):
    seen["host_heartbeats"] += 1
    if state["last_heartbeat"] is not None:
        gap = 1e3 * (stamp - state["last_heartbeat"])
        seen["worst_heartbeat_gap_ms"] = max(seen["worst_heartbeat_gap_ms"], gap)
    state["last_heartbeat"] = stamp


def on_nmt(_id, data, _time):
    command, address = data[0], data[1]
    if address not in (0, NODE):
        return
    if command == 1:
        node.rpdo.read()
        node.tpdo.read()
        seen["rpdo_deadline_ms"] = node.sdo[0x1400][5].raw
        seen["heartbeat_consumer"] = node.sdo[0x1016][1].raw
        seen["abort_option"] = node.sdo[0x6007].raw
        seen["mode"] = node.sdo[0x6060].raw
        network.subscribe(0x80, on_sync)
        network.send_message(0x700 + NODE, [5])
    elif command in (0x81, 0x82):
        network.send_message(0x700 + NODE, [0])


network = canopen.Network()
network.connect(interface="socketcan", channel=INTERFACE)
node = canopen.LocalNode(NODE, od.drive(NODE))
network.add_node(node)
network.subscribe(0, on_nmt)
network.subscribe(0x700 + 126, on_heartbeat)
node.nmt.send_command(0x82)
node.nmt.send_command(0x80)
print("ready", flush=True)
sys.stdin.readline()
print(json.dumps(seen), flush=True)
network.disconnect()
