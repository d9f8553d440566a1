"""Object dictionary of a CiA 402 drive for the `canopen` package, as both peers need it."""
import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes as t

DRIVE = [  # index, name, type, default, access
    (0x6007, "abort connection option", t.INTEGER16, 1, "rw"),
    (0x603F, "error code", t.UNSIGNED16, 0, "ro"),
    (0x6040, "controlword", t.UNSIGNED16, 0, "rw"),
    (0x6041, "statusword", t.UNSIGNED16, 0x40, "ro"),
    (0x605A, "quick stop option", t.INTEGER16, 2, "rw"),
    (0x6060, "mode", t.INTEGER8, 0, "rw"),
    (0x6061, "mode display", t.INTEGER8, 0, "ro"),
    (0x6064, "position actual", t.INTEGER32, 0, "ro"),
    (0x6065, "following error window", t.UNSIGNED32, 0, "rw"),
    (0x6066, "following error time", t.UNSIGNED16, 0, "rw"),
    (0x606C, "velocity actual", t.INTEGER32, 0, "ro"),
    (0x607A, "target position", t.INTEGER32, 0, "rw"),
    (0x6085, "quick stop deceleration", t.UNSIGNED32, 0, "rw"),
    (0x60B1, "velocity offset", t.INTEGER32, 0, "rw"),
    (0x60B2, "torque offset", t.INTEGER16, 0, "rw"),
    (0x60F4, "following error", t.INTEGER32, 0, "ro"),
    (0x6502, "supported modes", t.UNSIGNED32, 0xC0, "ro"),
]


def variable(name, index, sub, kind, default, access="rw"):
    entry = ODVariable(name, index, sub)
    entry.data_type, entry.default, entry.access_type = kind, default, access
    entry.pdo_mappable = True
    return entry


def record(dictionary, index, name, members):
    group = ODRecord(name, index)
    group.add_member(variable("number", index, 0, t.UNSIGNED8, len(members), "ro"))
    for sub, (label, kind, default) in members.items():
        group.add_member(variable(label, index, sub, kind, default))
    dictionary.add_object(group)


def drive(node):
    """The dictionary, PDOs invalid and unmapped."""
    d = canopen.ObjectDictionary()
    d.node_id = node
    d.add_object(variable("device type", 0x1000, 0, t.UNSIGNED32, 0x20192, "ro"))
    d.add_object(variable("error register", 0x1001, 0, t.UNSIGNED8, 0, "ro"))
    d.add_object(variable("cycle period", 0x1006, 0, t.UNSIGNED32, 0))
    d.add_object(variable("device name", 0x1008, 0, t.VISIBLE_STRING, "independent python drive", "ro"))
    record(d, 0x1016, "heartbeat consumer", {1: ("host", t.UNSIGNED32, 0)})
    d.add_object(variable("heartbeat producer", 0x1017, 0, t.UNSIGNED16, 0))
    record(d, 0x1018, "identity", {1: ("vendor", t.UNSIGNED32, 0xABCD), 2: ("product", t.UNSIGNED32, 0x402),
                                   3: ("revision", t.UNSIGNED32, 7), 4: ("serial", t.UNSIGNED32, 99)})
    for n in range(2):
        for base, cob in ((0x1400, 0x200), (0x1800, 0x180)):
            record(d, base + n, f"PDO communication {base + n:#x}", {
                1: ("id", t.UNSIGNED32, 0x80000000 + cob + 0x100 * n + node), 2: ("type", t.UNSIGNED8, 255),
                3: ("inhibit", t.UNSIGNED16, 0), 5: ("event timer", t.UNSIGNED16, 0)})
            record(d, base + 0x200 + n, f"PDO mapping {base + 0x200 + n:#x}",
                   {sub: (f"entry {sub}", t.UNSIGNED32, 0) for sub in range(1, 9)})
            d[base + 0x200 + n][0].access_type, d[base + 0x200 + n][0].default = "rw", 0
    record(d, 0x60C2, "interpolation period", {1: ("value", t.UNSIGNED8, 1), 2: ("exponent", t.INTEGER8, -3)})
    for index, name, kind, default, access in DRIVE:
        d.add_object(variable(name, index, 0, kind, default, access))
    return d
