"""Components whose topics, services and actions get ROS names."""

from cairn import (
    LATCHED,
    ActionServer,
    Component,
    In,
    Out,
    Server,
    ServerGoal,
    goal,
    on,
    serve,
)
from cairn.errors import CairnError
from cairn.schemas.example_interfaces.action import Fibonacci
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.std_msgs import String
from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import Joint, Transform


class Talker(Component):
    """Repeats what it hears, and has a camera."""

    heard: Out[String]
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    word: In[String] = In(optional=True)
    secret: In[String] = In(optional=True)
    stop: In[String] = In(optional=True, exclusive=True)
    own: In[String] = In(optional=True)
    operator_inputs = frozenset({"word", "secret"})
    confidential_inputs = frozenset({"secret"})

    def on_activate(self) -> None:
        joint = Joint("j", "fixed", "camera", "optical", Transform())
        self.tf_static.publish(TFMessage(transforms=(joint.message(),)))

    @on("word")
    def on_word(self, word: String) -> None:
        self.heard.publish(word)


class Reader(Component):
    """Reads exclusively."""

    heard: In[String] = In(exclusive=True)


class Worker(Component):
    """Adds, and counts."""

    add: Server[AddTwoInts.Request, AddTwoInts.Response]
    fibonacci: ActionServer[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]
    service_roles = {"add": "view", "fibonacci": "operate"}

    @serve("add")
    def on_add(self, request: AddTwoInts.Request) -> AddTwoInts.Response:
        if request.a < 0:
            raise CairnError("a is negative")
        return AddTwoInts.Response(sum=request.a + request.b)

    @goal("fibonacci")
    def begin(self, goal: ServerGoal[Fibonacci.Goal, Fibonacci.Result, Fibonacci.Feedback]) -> None:
        goal.publish_feedback(Fibonacci.Feedback(sequence=[0]))  # type: ignore[arg-type]
        goal.succeed(Fibonacci.Result(sequence=[0, 1]))  # type: ignore[arg-type]
