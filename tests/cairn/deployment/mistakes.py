"""Deployments with one mistake each: line, path, and the essential words of the problem.

Each part of the words, separated by semicolons, must be in the problem or its remedy.
"""

HEAD = "cairn: 1\ncomponents:\n"
PARTS = """\
  scanner: {plugin: acme_scanner, parameters: {device: /dev/ttyACM0}}
  base: {plugin: acme_base}
"""

CASES = {
    "unknown section": (
        HEAD + PARTS + "buss: {}\n",
        (5, "buss", "buss; did you mean bus?"),
    ),
    "unknown key of a component": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    topic: {odom: o2}\n",
        (7, "components.other.topic", "topic; did you mean topics?"),
    ),
    "name of the root": (
        HEAD + PARTS + "  root: {plugin: acme_base}\n",
        (
            5,
            "components.root",
            "root is the name of the root of the tree of components; give it another name",
        ),
    ),
    "missing version": (
        "components:\n" + PARTS,
        (1, "cairn", "is missing; give Version of this format"),
    ),
    "unknown version": (
        "cairn: 2\ncomponents:\n" + PARTS,
        (1, "cairn", "2 should be 1; expected Version of this format"),
    ),
    "no plugin given": (
        HEAD + PARTS + "  other:\n    restart: transient\n",
        (
            5,
            "components.other.plugin",
            "is missing; give Entry point of group cairn.components, or package.module:Class",
        ),
    ),
    "misspelled plugin": (
        HEAD + PARTS + "  other:\n    plugin: acme_locaizer\n",
        (
            6,
            "components.other.plugin",
            "plugin acme_locaizer; did you mean acme_localizer? "
            "(`cairn plugins` lists all; package.module:Class names a class directly)",
        ),
    ),
    "misspelled module": (
        HEAD + PARTS + "  other: {plugin: 'acme_robots.parts:Base'}\n",
        (
            5,
            "components.other.plugin",
            "module acme_robots.parts; "
            "correct the name, install the package that holds it, or put the folder of a single "
            "file on PYTHONPATH",
        ),
    ),
    "misspelled class": (
        HEAD + PARTS + "  other: {plugin: 'acme_robot.parts:Bass'}\n",
        (
            5,
            "components.other.plugin",
            "acme_robot.parts has no class Bass; did you mean Base?",
        ),
    ),
    "not a component": (
        HEAD + PARTS + "  other: {plugin: acme_no_component}\n",
        (
            5,
            "components.other.plugin",
            "acme_robot.parts:ScannerConfig is not a component; "
            "derive the class from cairn.Component",
        ),
    ),
    "port without a message type": (
        HEAD + PARTS + "  other: {plugin: acme_odd_port}\n",
        (
            5,
            "components.other.plugin",
            "acme_robot.odd.OddPort.something: the port has no message type; annotate it, as in "
            "`something: Out[LaserScan]`; correct the class, or use another plugin",
        ),
    ),
    "unknown parameter": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    parameters:\n"
        "      gains: [1, 2]\n      partcles: 5\n",
        (
            9,
            "components.localizer.parameters.partcles",
            "partcles; did you mean particles?",
        ),
    ),
    "parameter out of bounds": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    parameters:\n"
        "      particles: 5\n",
        (
            8,
            "components.localizer.parameters.particles",
            "5 should be greater than or equal to 10; "
            "expected Number of particles [1] (>= 10, <= 200000)",
        ),
    ),
    "parameter of a nested model": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    parameters:\n"
        "      filter:\n        sigma: 2.5\n",
        (
            9,
            "components.localizer.parameters.filter.sigma",
            "2.5 should be less than or equal to 1; expected Noise of a beam [m] (> 0, <= 1)",
        ),
    ),
    "item of a list of parameters": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    parameters:\n"
        "      gains:\n      - 1.0\n      - fast\n",
        (
            10,
            "components.localizer.parameters.gains.1",
            "'fast' should be a valid number, unable to parse string as a number; "
            "expected Gains [1]",
        ),
    ),
    "parameters that are not a mapping": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    parameters: [5]\n",
        (
            7,
            "components.localizer.parameters",
            "a list should be a mapping; expected Values for the plugin's Config",
        ),
    ),
    "missing parameter": (
        HEAD + "  scanner:\n    plugin: acme_scanner\n    parameters:\n      rate: 5\n",
        (5, "components.scanner.parameters.device", "is missing; give Serial device (not empty)"),
    ),
    "missing parameter without any parameters": (
        HEAD + "  scanner:\n    plugin: acme_scanner\n",
        (3, "components.scanner.parameters.device", "is missing; give Serial device (not empty)"),
    ),
    "validator that fails": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n"
        "    parameters: {map_file: a.bmp}\n",
        (
            7,
            "components.localizer.parameters",
            "the check of its values failed: KeyError: 'a.bmp'; "
            "correct acme_robot.parts.LocalizerConfig, or the values",
        ),
    ),
    "unknown port": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    topics:\n      odm: odom2\n",
        (8, "components.other.topics.odm", "port odm; did you mean odom?"),
    ),
    "topic that is not a name": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    topics:\n      odom: odom-2\n",
        (
            8,
            "components.other.topics.odom",
            "'odom-2' should match pattern "
            "'^/?[a-zA-Z_][a-zA-Z0-9_]*(/[a-zA-Z_][a-zA-Z0-9_]*)*$'; "
            "expected Topic of a port, below /<robot>/ unless it begins with /",
        ),
    ),
    "two types on a topic": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    topics:\n      odom: scan\n",
        (
            8,
            "components.other.topics.odom",
            "topic scan has two types: odom publishes nav_msgs/msg/Odometry, but "
            "scanner.scan publishes "
            "sensor_msgs/msg/LaserScan; give one of them another topic",
        ),
    ),
    "input without a publisher": (
        HEAD + PARTS + "  localizer:\n    plugin: acme_localizer\n    topics:\n      scan: scans\n",
        (
            8,
            "components.localizer.topics.scan",
            "no component publishes topic scans, which input scan needs; "
            "add its publisher, correct the topic, "
            "or list it under external_topics; did you mean scan?",
        ),
    ),
    "two writers of an exclusive topic": (
        HEAD + PARTS + "  wheels: {plugin: 'acme_robot.parts:Wheels', topics: {command: odom}}\n"
        "  other:\n    plugin: acme_base\n",
        (
            7,
            "components.other.topics.odom",
            "topic odom has several writers, base and other, but wheels reads it exclusively; "
            "give all but one of them another topic",
        ),
    ),
    "two writers of a topic with an exclusive writer": (
        HEAD + PARTS + "  driver: {plugin: 'acme_robot.parts:Driver'}\n"
        "  other: {plugin: 'acme_robot.parts:Driver', topics: {wheels: wheels}}\n",
        (
            6,
            "components.other.topics.wheels",
            "topic wheels has several writers, driver and other, but driver must be the only one; "
            "give all but one of them another topic",
        ),
    ),
    "name used twice": (
        HEAD + PARTS + "  boss:\n    plugin: acme_supervisor\n    children:\n"
        "      base: {plugin: acme_base}\n",
        (
            8,
            "components.base",
            "the name base is used twice, first at robot.yaml:4; give it another name",
        ),
    ),
    "key given twice": (
        HEAD + PARTS + "  base:\n    plugin: acme_base\n",
        (
            5,
            "components.base",
            "the key occurs twice, first at robot.yaml:4; remove one",
        ),
    ),
    "children of a plain component": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    children:\n"
        "      another: {plugin: acme_base}\n",
        (
            7,
            "components.other.children",
            "Base is not a supervisor; move it to a supervisor, or remove it",
        ),
    ),
    "supervision by a plain component": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    supervision: {max_restarts: 1}\n",
        (
            7,
            "components.other.supervision",
            "Base is not a supervisor; move it to a supervisor, or remove it",
        ),
    ),
    "significant but permanent": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    significant: true\n",
        (
            7,
            "components.other.significant",
            "a permanent component is restarted when it ends, so it cannot end the deployment; "
            "add `restart: transient` or `restart: temporary`",
        ),
    ),
    "memory limit in the parent's process": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    placement: in_process\n"
        "    memory_max_mib: 512\n",
        (
            8,
            "components.other.memory_max_mib",
            "the memory of a component in its parent's process is its parent's; "
            "set it for the parent, or use placement: process",
        ),
    ),
    "fresh interpreter in the parent's process": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    placement: in_process\n"
        "    interpreter: fresh\n",
        (
            8,
            "components.other.interpreter",
            "a component in its parent's process uses its parent's interpreter; "
            "use placement: process",
        ),
    ),
    "wrong choice": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    restart: always\n",
        (
            7,
            "components.other.restart",
            "'always' should be 'permanent', 'transient' or 'temporary'; expected Restarted "
            "always, only after an abnormal end (transient), or never",
        ),
    ),
    "number as text": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    stop_timeout_s: '5'\n",
        (
            7,
            "components.other.stop_timeout_s",
            "'5' should be a valid number; "
            "expected Limit for stopping [s]; then its process is killed "
            "(> 0, <= 3600)",
        ),
    ),
    "stop limits": (
        HEAD + PARTS + "  other:\n    plugin: acme_base\n    stop_timeout_s: 10\n",
        (
            7,
            "components.other.stop_timeout_s",
            "10 s are not less than the deployment's stop_limit_s, 10 s; "
            "decrease it, or increase stop_limit_s",
        ),
    ),
    "component name": (
        HEAD + PARTS + "  Other: {plugin: acme_base}\n",
        (
            5,
            "components.Other",
            "'Other' is not a valid name; "
            "names are lower-case letters, digits and _, and begin with a letter",
        ),
    ),
    "simulated clock without a writer": (
        "cairn: 1\nclock: simulated\ncomponents:\n" + PARTS,
        (
            2,
            "clock",
            "the clock is simulated, but no component publishes rosgraph_msgs/msg/Clock on topic "
            "clock; add one that does, list clock under external_topics, or use clock: system",
        ),
    ),
    "simulated clock whose writer waits for it": (
        "cairn: 1\nclock: simulated\ncomponents:\n"
        "  other: {plugin: 'acme_robot.parts:WaitingSimulator', topics: {time: clock}}\n",
        (
            4,
            "components.other.topics.time",
            "WaitingSimulator publishes the simulated clock but uses it itself; "
            'give the class `clock_source = "system"`',
        ),
    ),
    "a device in simulated time": (
        "cairn: 1\nclock: simulated\nexternal_topics: [clock]\ncomponents:\n"
        "  other: {plugin: 'acme_robot.parts:ScannerDriver'}\n",
        (
            5,
            "components.other.plugin",
            "ScannerDriver drives a device, which cannot follow simulated time; use clock: system, "
            "or put a simulated or replayed driver in its place",
        ),
    ),
    "listening to the network": (
        "cairn: 1\nbus:\n  listen: [tcp/0.0.0.0:7447]\ncomponents:\n" + PARTS,
        (
            3,
            "bus.listen",
            "tcp/0.0.0.0:7447 can be reached from other machines, and anyone who reaches it could "
            "drive the robot; listen on 127.0.0.1, or add `allow_remote: true`; in both cases add "
            "`users` with passwords, or `tls` with `identity` (cairn security), or `tls` with "
            "client certificates and `certificate_roles`, or, on loopback, "
            "`allow_any_local_user: true`; "
            "expected Network endpoints on which the router listens as well",
        ),
    ),
    "an endpoint without a port": (
        "cairn: 1\nbus: {connect: [tcp/127.0.0.1]}\ncomponents:\n" + PARTS,
        (
            2,
            "bus.connect.0",
            "'tcp/127.0.0.1' is not an endpoint; write protocol/host:port as in "
            "tcp/127.0.0.1:7447, with protocol tcp, tls, quic, udp or ws and a port from 1 to "
            "65535, or the path of a Unix socket as in /run/cairn/domain-0.sock; "
            "expected Endpoints of running routers to join; then `cairn up` opens none",
        ),
    ),
    "listening and connecting": (
        "cairn: 1\nbus:\n  connect: ['tcp/127.0.0.1:7500']\n  listen: [tcp/127.0.0.1:7600]\n"
        "components:\n" + PARTS,
        (
            4,
            "bus.listen",
            "with `connect` no router is opened, so `listen` has no effect; keep `connect` to join "
            "a router that runs already, or `listen` to open one; "
            "expected Network endpoints on which the router listens as well",
        ),
    ),
    "unknown setting in a value": (
        "cairn: 1\nsettings: {rate: 5}\ncomponents:\n" + PARTS + "  localizer:\n"
        "    plugin: acme_localizer\n    parameters: {particles: '${rat}'}\n",
        (
            8,
            "components.localizer.parameters.particles",
            "setting rat; did you mean rate?",
        ),
    ),
    "no component at all": (
        "cairn: 1\ncomponents: {}\n",
        (
            2,
            "components",
            "a mapping should have at least 1 item after validation, not 0; "
            "expected The components in start order (not empty)",
        ),
    ),
}
