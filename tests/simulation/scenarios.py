"""Scenarios of Zenoh as applications observe it: each holds in the model and in Zenoh."""

from collections.abc import Callable

from tests.simulation.stages import Part, Stage

SCENARIOS: dict[str, Callable[[Stage], None]] = {}


def scenario(play: Callable[[Stage], None]) -> Callable[[Stage], None]:
    """A scenario of the table."""
    SCENARIOS[play.__name__] = play
    return play


def _pair(stage: Stage, **options: str):
    a, b = stage.open("a", "h1", **options), stage.open("b", "h2", **options)
    b.expect("links", gives=[a.id()])
    a.expect("links", gives=[b.id()])
    return a, b


def _let_arrive(a: Part, b: Part) -> None:
    """Wait until all that `a` has sent is with `b`, or dropped there: a new publisher sends until
    it knows who listens, and a subscriber of `b` that comes meanwhile gets it.
    """
    b.subscriber("mark", "mark")
    a.publisher("mark")
    a.expect("heard", "mark", gives=True)
    a.put("mark", "past")
    b.expects("mark", "mark=past")


def _subscribe(a: Part, b: Part, key: str = "k") -> None:
    """`b` subscribes to what `a` publishes, which `a` knows then; it comes as "in"."""
    b.subscriber("in", key)
    a.publisher(key)
    a.expect("heard", key, gives=True)


def _show_token(a: Part, b: Part, key: str = "t", *, among: str = "") -> None:
    """`a` has a token, that `b` sees among those that it watches as "seen"."""
    b.watch("seen", among or key)
    a.token(key)
    b.expects("seen", f"+{key}")


# Publications


@scenario
def a_message_reaches_a_subscriber_of_another_host(stage: Stage) -> None:
    a, b = _pair(stage)
    _subscribe(a, b, "k/1")
    a.put("k/1", "x")
    b.expects("in", "k/1=x")


@scenario
def messages_of_one_publisher_come_in_order(stage: Stage) -> None:
    """A busy host drops some, as a congested link does, but none overtakes another."""
    a, b = _pair(stage)
    _subscribe(a, b)
    for number in range(20):
        a.put("k", str(number))

    def has_the_last() -> bool:
        a.put("k", "20")
        return "k=20" in b.events("in")

    assert stage.wait(has_the_last)
    came = [int(event.removeprefix("k=")) for event in b.events("in")]
    assert came == sorted(came)


@scenario
def a_message_reaches_its_own_session_at_once(stage: Stage) -> None:
    a = stage.open("a")
    a.subscriber("in", "k")
    a.publisher("k")
    a.put("k", "x")
    assert a.events("in") == ["k=x"]


@scenario
def a_subscriber_of_others_hears_nothing_of_its_own(stage: Stage) -> None:
    a, b = _pair(stage)
    a.subscriber("in", "k", True)
    a.publisher("k")
    b.publisher("k")
    a.put("k", "mine")
    b.expect("heard", "k", gives=True)
    b.put("k", "yours")
    a.expects("in", "k=yours")


@scenario
def of_two_subscribers_of_a_key_the_end_of_one_leaves_the_other(stage: Stage) -> None:
    b = stage.open("b", "h2")
    b.subscriber("in", "k")
    b.subscriber("too", "k")
    a = stage.open("a")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    b.end("too")
    _let_arrive(b, a)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def one_star_stands_for_one_chunk(stage: Stage) -> None:
    a, b = _pair(stage)
    b.subscriber("in", "k/*")
    for key in ("k/1", "k/1/2", "k"):
        a.publisher(key)
    a.expect("heard", "k/1", gives=True)
    assert [a.heard(key) for key in ("k/1/2", "k")] == [False, False]


@scenario
def two_stars_stand_for_any_chunks_but_hidden_ones(stage: Stage) -> None:
    a, b = _pair(stage)
    b.subscriber("in", "k/**")
    for key in ("k", "k/1/2", "k/@x/1"):
        a.publisher(key)
    a.expect("heard", "k/1/2", gives=True)
    a.expect("heard", "k", gives=True)
    assert a.heard("k/@x/1") is False


@scenario
def a_late_subscriber_misses_what_was_sent_before(stage: Stage) -> None:
    a, b = _pair(stage)
    a.publisher("k")
    a.put("k", "early")
    _let_arrive(a, b)
    b.subscriber("in", "k")
    a.expect("heard", "k", gives=True)
    a.put("k", "late")
    b.expects("in", "k=late")


@scenario
def a_subscriber_that_ended_is_no_longer_heard(stage: Stage) -> None:
    a, b = _pair(stage)
    _subscribe(a, b)
    b.end("in")
    a.expect("heard", "k", gives=False)


@scenario
def two_subscribers_of_a_session_get_each_message_once(stage: Stage) -> None:
    a, b = _pair(stage)
    b.subscriber("one", "k/*")
    b.subscriber("other", "k/1")
    a.publisher("k/1")
    a.expect("heard", "k/1", gives=True)
    a.put("k/1", "x")
    b.expects("one", "k/1=x")
    b.expects("other", "k/1=x")


@scenario
def a_publisher_is_heard_until_the_last_subscriber_ends(stage: Stage) -> None:
    a, b = _pair(stage)
    b.subscriber("one", "k")
    b.subscriber("other", "k")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    b.end("one")
    a.put("k", "x")
    b.expects("other", "k=x")
    assert a.heard("k") is True
    b.end("other")
    a.expect("heard", "k", gives=False)


@scenario
def a_publisher_is_not_heard_once_its_subscriber_is_killed(stage: Stage) -> None:
    a, b = _pair(stage)
    _subscribe(a, b)
    b.kill()
    a.expect("heard", "k", gives=False)


@scenario
def a_closed_session_refuses_to_send(stage: Stage) -> None:
    a = stage.open("a")
    a.publisher("k")
    a.close()
    assert a.put("k", "x").startswith("BusError: could not publish k")


# Retained messages


@scenario
def a_late_subscriber_gets_the_retained_message(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    b.retained_subscriber("in", "k")
    b.expects("in", "k=1")


@scenario
def a_late_subscriber_gets_only_the_last_retained_message(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    a.put("k", "2")
    _let_arrive(a, b)
    b.retained_subscriber("in", "k")
    b.expects("in", "k=2")


@scenario
def a_retained_publisher_that_comes_later_is_found(stage: Stage) -> None:
    a = stage.open("a", "h1")
    a.retained_subscriber("in", "k/*")
    b = stage.open("b", "h2")
    b.retained_publisher("k/1")
    b.put("k/1", "x")
    a.expects_all("in", "k/1=x")


@scenario
def retained_messages_of_two_publishers_both_come(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k")
    b.retained_publisher("k")
    a.put("k", "a")
    b.put("k", "b")
    c = stage.open("c", "h3")
    c.retained_subscriber("in", "k")
    c.expects_all("in", "k=a", "k=b")


@scenario
def a_plain_subscriber_misses_the_retained_message(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    _let_arrive(a, b)
    b.subscriber("in", "k")
    a.expect("heard", "k", gives=True)
    a.put("k", "2")
    b.expects("in", "k=2")


@scenario
def what_is_retained_can_be_asked_for(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k/1")
    a.put("k/1", "x")
    b.expect("ask_retained", "k/*", gives=["k/1=x"])


@scenario
def a_retained_message_is_gone_with_its_publisher(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("k")
    a.put("k", "x")
    b.expect("ask_retained", "k", gives=["k=x"])
    a.kill()
    b.expect("ask_retained", "k", gives=[])


@scenario
def a_retained_message_at_a_hidden_key_can_be_asked_for(stage: Stage) -> None:
    a, b = _pair(stage)
    a.retained_publisher("@h/s/1")
    a.put("@h/s/1", "x")
    b.expect("ask_retained", "@h/s/1", gives=["@h/s/1=x"])


# Queries


@scenario
def a_query_is_answered(stage: Stage) -> None:
    a, b = _pair(stage)
    a.queryable("q", "q/1", "yes")
    b.expect("ask", "q/1", gives=["q/1=yes"])


@scenario
def a_query_brings_its_payload(stage: Stage) -> None:
    a, b = _pair(stage)
    a.queryable("q", "q", "you said ")
    b.expect("ask", "q", 5.0, "hello", gives=["q=you said hello"])


@scenario
def a_query_of_nothing_ends_at_once_without_answers(stage: Stage) -> None:
    a, _ = _pair(stage)
    assert a.ask("q/none", 20.0) == []


@scenario
def all_queryables_answer(stage: Stage) -> None:
    a, b = _pair(stage)
    c = stage.open("c", "h3")
    a.queryable("q", "q/a", "1")
    b.queryable("q", "q/b", "2")
    c.expect("ask", "q/*", gives=["q/a=1", "q/b=2"])


@scenario
def a_session_answers_itself_too(stage: Stage) -> None:
    a, b = _pair(stage)
    a.queryable("q", "q/a", "1")
    b.queryable("q", "q/b", "2")
    a.expect("ask", "q/*", gives=["q/a=1", "q/b=2"])


@scenario
def several_answers_of_one_queryable_all_come(stage: Stage) -> None:
    a, b = _pair(stage)
    a.queryable("q", "q", "1", "2", "3")
    b.expect("ask", "q", gives=["q=1", "q=2", "q=3"])


@scenario
def a_refusal_comes_with_its_text(stage: Stage) -> None:
    a, b = _pair(stage)
    a.refusing_queryable("q", "q", "not now")
    b.expect("ask", "q", gives=["refused: not now"])


@scenario
def a_query_ends_after_its_time(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    b.expect("served", "q", gives=True)
    b.ask_later("asked", "q", 1.0)
    b.expects_all("asked", "end")


@scenario
def a_query_ends_when_the_answering_process_is_killed(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    b.expect("served", "q", gives=True)
    b.ask_later("asked", "q", 60.0)
    a.kill()
    b.expects("asked", "end")


@scenario
def a_query_ends_when_all_have_closed_it(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    b.expect("served", "q", gives=True)
    b.ask_later("asked", "q", 60.0)

    def is_ended() -> bool:
        a.release()
        return b.events("asked") == ["end"]

    assert stage.wait(is_ended)


@scenario
def a_query_of_its_own_session_ends_when_that_has_closed_it(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    a.ask_later("asked", "q", 60.0)
    # A message there and back passes in the meantime.
    _subscribe(b, a)
    b.put("k", "x")
    a.expects("in", "k=x")
    a.expects("asked")

    def is_ended() -> bool:
        a.release()
        return a.events("asked") == ["end"]

    assert stage.wait(is_ended)


@scenario
def a_query_of_a_host_without_its_cable_ends(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    b.expect("served", "q", gives=True)
    b.ask_later("asked", "q", 60.0)
    stage.set_cable("h1", plugged=False)
    b.expects("asked", "end")


@scenario
def a_queryable_that_ended_is_no_longer_served(stage: Stage) -> None:
    a, b = _pair(stage)
    a.queryable("q", "q", "1")
    b.expect("served", "q", gives=True)
    a.end("q")
    b.expect("served", "q", gives=False)
    assert b.ask("q", 20.0) == []


# Tokens


@scenario
def a_token_is_seen(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")


@scenario
def a_token_that_was_there_before_is_seen(stage: Stage) -> None:
    a, b = _pair(stage)
    a.token("t/1")
    b.expect("living", "t/*", gives=["t/1"])
    b.watch("seen", "t/*")
    b.expects("seen", "+t/1")


@scenario
def a_token_of_its_own_session_is_seen(stage: Stage) -> None:
    a = stage.open("a")
    _show_token(a, a, "t/1", among="t/*")


@scenario
def a_token_ends(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")
    a.end("token t/1")
    b.expects("seen", "+t/1", "-t/1")


@scenario
def a_token_ends_with_its_session(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")
    a.close()
    b.expects("seen", "+t/1", "-t/1")


@scenario
def a_token_ends_with_its_process(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")
    a.kill()
    b.expects("seen", "+t/1", "-t/1")


@scenario
def a_token_ends_when_its_host_is_unplugged_and_comes_back(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")
    stage.set_cable("h1", plugged=False)
    b.expects("seen", "+t/1", "-t/1")
    stage.set_cable("h1", plugged=True)
    b.expects("seen", "+t/1", "-t/1", "+t/1")


@scenario
def a_token_of_a_stopped_process_ends_and_comes_back(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "t/1", among="t/*")
    a.stop()
    b.expects("seen", "+t/1", "-t/1")
    a.go_on()
    b.expects("seen", "+t/1", "-t/1", "+t/1")


@scenario
def one_token_of_two_sessions_is_seen_once_and_ends_with_the_last(stage: Stage) -> None:
    a, b = _pair(stage)
    c = stage.open("c", "h3")
    a.token("t")
    b.token("t")
    c.expect("living", "t", gives=["t"])
    c.expect("links", gives=sorted([a.id(), b.id()]))
    c.watch("seen", "t")
    c.expects("seen", "+t")
    a.kill()
    c.expect("links", gives=[b.id()])
    assert c.events("seen") == ["+t"]
    b.kill()
    c.expects("seen", "+t", "-t")


@scenario
def tokens_of_several_sessions_are_listed(stage: Stage) -> None:
    a, b = _pair(stage)
    a.token("t/a")
    b.token("t/b")
    c = stage.open("c", "h3")
    c.expect("living", "t/*", gives=["t/a", "t/b"])


@scenario
def a_watch_that_ended_sees_nothing_more(stage: Stage) -> None:
    a, b = _pair(stage)
    b.watch("seen", "t/*")
    b.watch("beside", "t/*")
    b.end("seen")
    a.token("t/1")
    b.expects("beside", "+t/1")
    assert b.events("seen") == []


@scenario
def a_token_at_a_hidden_key_is_seen(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b, "@h/n/1", among="@h/n/*")


# Namespaces


@scenario
def a_session_of_a_namespace_names_its_keys_without_it(stage: Stage) -> None:
    a, b = _pair(stage, namespace="robot7")
    _subscribe(a, b)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_session_outside_sees_the_namespace(stage: Stage) -> None:
    a = stage.open("a", "h1", namespace="robot7")
    b = stage.open("b", "h2")
    b.subscriber("in", "**/k")
    b.watch("seen", "**/@h/*")
    a.publisher("k")
    a.token("@h/1")
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "robot7/k=x")
    b.expects("seen", "+robot7/@h/1")


@scenario
def a_query_of_all_reaches_a_namespace(stage: Stage) -> None:
    a = stage.open("a", "h1", namespace="robot7")
    b = stage.open("b", "h2")
    a.queryable("q", "@h/1", "x")
    for expression in ("**/@h/*", "*/@h/1", "robot7/@h/*"):
        b.expect("ask", expression, 5.0, "", gives=["robot7/@h/1=x"])


@scenario
def namespaces_are_apart(stage: Stage) -> None:
    a = stage.open("a", "h1", namespace="robot7")
    b = stage.open("b", "h2", namespace="robot8")
    b.expect("links", gives=[a.id()])
    b.subscriber("in", "k")
    b.queryable("q", "q", "no")
    c = stage.open("c", "h3", namespace="robot8")
    c.publisher("k")
    c.expect("heard", "k", gives=True)
    a.publisher("k")
    assert a.heard("k") is False
    assert a.ask("q", 20.0) == []


@scenario
def tokens_of_other_namespaces_are_not_seen(stage: Stage) -> None:
    a = stage.open("a", "h1", namespace="robot7")
    b = stage.open("b", "h2", namespace="robot8")
    c = stage.open("c", "h3", namespace="robot8")
    b.expect("links", gives=sorted([a.id(), c.id()]))
    b.watch("seen", "**")
    a.token("t/a")
    c.token("t/c")
    b.expects("seen", "+t/c")


# Links


@scenario
def links_are_known_at_both_ends(stage: Stage) -> None:
    _pair(stage)


@scenario
def a_killed_process_has_no_link(stage: Stage) -> None:
    a, b = _pair(stage)
    b.kill()
    a.expect("links", gives=[])


@scenario
def an_unplugged_host_has_no_link_until_it_is_plugged_in(stage: Stage) -> None:
    a, b = _pair(stage)
    stage.set_cable("h2", plugged=False)
    a.expect("links", gives=[])
    b.expect("links", gives=[])
    stage.set_cable("h2", plugged=True)
    a.expect("links", gives=[b.id()])
    b.expect("links", gives=[a.id()])


@scenario
def what_was_declared_while_apart_is_known_when_together(stage: Stage) -> None:
    a, b = _pair(stage)
    stage.set_cable("h2", plugged=False)
    a.expect("links", gives=[])
    b.subscriber("in", "k")
    b.queryable("q", "q", "yes")
    b.token("t")
    a.publisher("k")
    stage.set_cable("h2", plugged=True)
    a.expect("heard", "k", gives=True)
    a.expect("ask", "q", gives=["q=yes"])
    a.expect("living", "t", gives=["t"])


@scenario
def what_ended_while_apart_is_not_known_when_together(stage: Stage) -> None:
    a, b = _pair(stage)
    b.token("t")
    b.queryable("q", "q", "yes")
    a.expect("ask", "q", gives=["q=yes"])
    stage.set_cable("h2", plugged=False)
    a.expect("links", gives=[])
    b.end("token t")
    b.end("q")
    stage.set_cable("h2", plugged=True)
    a.expect("links", gives=[b.id()])
    a.expect("living", "t", gives=[])
    assert a.ask("q", 20.0) == []


@scenario
def a_restarted_process_takes_the_place_of_the_former(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(b, a)
    b.kill()
    a.expects("seen", "+t", "-t")
    c = stage.open("b", "h2")
    c.token("t")
    a.expects("seen", "+t", "-t", "+t")


# Routers


def _star(stage: Stage):
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    at = stage.address("h3")
    a = stage.open("a", "h1", mode="client", connect=at)
    b = stage.open("b", "h2", mode="client", connect=at)
    a.expect("links", gives=[hub.id()])
    b.expect("links", gives=[hub.id()])
    return hub, a, b


@scenario
def a_message_crosses_a_router(stage: Stage) -> None:
    _, a, b = _star(stage)
    _subscribe(a, b)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_query_crosses_a_router(stage: Stage) -> None:
    _, a, b = _star(stage)
    a.queryable("q", "q", "yes")
    b.expect("ask", "q", gives=["q=yes"])


@scenario
def a_token_crosses_a_router(stage: Stage) -> None:
    _, a, b = _star(stage)
    _show_token(a, b)
    a.kill()
    b.expects("seen", "+t", "-t")


@scenario
def a_retained_message_crosses_a_router(stage: Stage) -> None:
    _, a, b = _star(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    b.retained_subscriber("in", "k")
    b.expects("in", "k=1")


@scenario
def a_router_sees_what_its_clients_declare(stage: Stage) -> None:
    hub, a, _ = _star(stage)
    hub.watch("seen", "t")
    a.token("t")
    hub.expects("seen", "+t")


@scenario
def all_tokens_end_with_the_router(stage: Stage) -> None:
    hub, a, b = _star(stage)
    _show_token(a, b)
    hub.kill()
    b.expects("seen", "+t", "-t")


def _sites(stage: Stage):
    """A hub, and two sites: the router of each joins the hub as a client, and has one itself."""
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    sites, clients = zip(*(_site(stage, host) for host in ("h1", "h2")), strict=True)
    return hub, sites, clients


def _site(stage: Stage, host: str):
    """The router of a site, and a client of it."""
    site = {"mode": "client", "listen": "tcp/[::]:7447", "connect": stage.address("h3")}
    router = stage.open(f"site_{host}", host, **site)
    return router, stage.open(f"robot_{host}", host, mode="client", connect=stage.address(host))


@scenario
def a_message_crosses_the_hub_of_two_sites(stage: Stage) -> None:
    _, _, (a, b) = _sites(stage)
    _subscribe(a, b)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_query_crosses_the_hub_of_two_sites(stage: Stage) -> None:
    _, _, (a, b) = _sites(stage)
    a.queryable("q", "q", "yes")
    b.expect("ask", "q", gives=["q=yes"])


@scenario
def a_retained_message_crosses_the_hub_of_two_sites(stage: Stage) -> None:
    _, _, (a, b) = _sites(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    b.retained_subscriber("in", "k")
    b.expects("in", "k=1")


@scenario
def tokens_of_a_site_end_with_its_hub_for_others_alone(stage: Stage) -> None:
    hub, (site, _), (a, b) = _sites(stage)
    _show_token(a, b)
    site.watch("near", "t")
    site.expects("near", "+t")
    hub.kill()
    b.expects("seen", "+t", "-t")
    assert site.events("near") == ["+t"]


@scenario
def a_site_declares_its_tokens_to_a_hub_that_is_back(stage: Stage) -> None:
    hub, _, (a, b) = _sites(stage)
    _show_token(a, b)
    hub.kill()
    b.expects("seen", "+t", "-t")
    stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    b.expects("seen", "+t", "-t", "+t")


@scenario
def a_site_is_served_before_its_hub_is_there(stage: Stage) -> None:
    _, a = _site(stage, "h1")
    b = stage.open("b", "h1", mode="client", connect=stage.address("h1"))
    _show_token(a, b)
    _subscribe(a, b)
    a.put("k", "x")
    b.expects("in", "k=x")
    stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    _, far = _site(stage, "h2")
    far.watch("seen", "t")
    far.expects("seen", "+t")
    assert b.events("seen") == ["+t"]


@scenario
def tokens_end_with_the_router_of_their_site(stage: Stage) -> None:
    _, (site, _), (a, b) = _sites(stage)
    _show_token(a, b)
    site.kill()
    b.expects("seen", "+t", "-t")


def _line(stage: Stage, *, is_mesh: bool = False):
    """A router on each host, the second linked to the others; a client at the first and last."""
    r2 = stage.open("r2", "h2", mode="router", listen="tcp/[::]:7447")
    middle = stage.address("h2")
    r1 = stage.open("r1", "h1", mode="router", listen="tcp/[::]:7447", connect=middle)
    ends = [middle, stage.address("h1")] if is_mesh else middle
    r3 = stage.open("r3", "h3", mode="router", listen="tcp/[::]:7447", connect=ends)
    a = stage.open("a", "h1", mode="client", connect=stage.address("h1"))
    b = stage.open("b", "h3", mode="client", connect=stage.address("h3"))
    a.expect("links", gives=[r1.id()])
    b.expect("links", gives=[r3.id()])
    r3.expect("links", gives=sorted([r2.id(), b.id(), *([r1.id()] if is_mesh else [])]))
    return (r1, r2, r3), a, b


@scenario
def a_message_crosses_three_routers(stage: Stage) -> None:
    _, a, b = _line(stage)
    _subscribe(a, b)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_query_crosses_three_routers(stage: Stage) -> None:
    _, a, b = _line(stage)
    a.queryable("q", "q", "1", "2")
    b.expect("ask", "q", gives=["q=1", "q=2"])


@scenario
def a_retained_message_crosses_three_routers(stage: Stage) -> None:
    _, a, b = _line(stage)
    a.retained_publisher("k")
    a.put("k", "1")
    b.retained_subscriber("in", "k")
    b.expects("in", "k=1")


@scenario
def a_token_crosses_three_routers_and_ends(stage: Stage) -> None:
    _, a, b = _line(stage)
    _show_token(a, b)
    a.kill()
    b.expects("seen", "+t", "-t")


@scenario
def a_token_ends_with_a_router_on_its_way_and_comes_back(stage: Stage) -> None:
    (_, r2, _), a, b = _line(stage)
    _show_token(a, b)
    r2.kill()
    b.expects("seen", "+t", "-t")
    stage.open("r2", "h2", mode="router", listen="tcp/[::]:7447")
    b.expects("seen", "+t", "-t", "+t")


@scenario
def a_token_ends_while_its_router_is_unplugged(stage: Stage) -> None:
    _, a, b = _line(stage)
    _show_token(a, b)
    stage.set_cable("h1", plugged=False)
    b.expects("seen", "+t", "-t")
    stage.set_cable("h1", plugged=True)
    b.expects("seen", "+t", "-t", "+t")


@scenario
def a_token_of_a_router_is_seen_by_clients_of_others(stage: Stage) -> None:
    (r1, _, _), _, b = _line(stage)
    b.watch("seen", "t")
    r1.token("t")
    b.expects("seen", "+t")
    r1.kill()
    b.expects("seen", "+t", "-t")


@scenario
def a_stopped_router_takes_its_clients_tokens_away(stage: Stage) -> None:
    (r1, _, _), a, b = _line(stage)
    _show_token(a, b)
    r1.stop()
    b.expects("seen", "+t", "-t")
    r1.go_on()
    b.expects("seen", "+t", "-t", "+t")


@scenario
def a_mesh_of_routers_delivers_each_message_once(stage: Stage) -> None:
    _, a, b = _line(stage, is_mesh=True)
    _subscribe(a, b)
    for number in range(10):
        a.put("k", str(number))
    b.expects("in", *(f"k={number}" for number in range(10)))


@scenario
def a_mesh_of_routers_answers_once(stage: Stage) -> None:
    (r1, _, _), a, b = _line(stage, is_mesh=True)
    a.queryable("q", "q/a", "1")
    r1.queryable("q", "q/r", "2")
    b.expect("ask", "q/*", gives=["q/a=1", "q/r=2"])


@scenario
def a_mesh_of_routers_finds_another_way(stage: Stage) -> None:
    (_, r2, r3), a, b = _line(stage, is_mesh=True)
    _subscribe(a, b)
    _set_ways(stage, "h1", "h3", are_open=False)
    r3.expect("links", gives=sorted([r2.id(), b.id()]))

    def has_come() -> bool:
        a.put("k", "x")
        return "k=x" in b.events("in")

    assert stage.wait(has_come)


@scenario
def a_mesh_of_routers_outlives_one_of_them(stage: Stage) -> None:
    (_, r2, r3), a, b = _line(stage, is_mesh=True)
    a.queryable("q", "q", "yes")
    b.expect("ask", "q", gives=["q=yes"])
    r2.kill()
    r3.expect("ask", "q", gives=["q=yes"])
    b.expect("ask", "q", gives=["q=yes"])


@scenario
def a_client_moves_to_its_second_router(stage: Stage) -> None:
    r1 = stage.open("r1", "h1", mode="router", listen="tcp/[::]:7447")
    at = stage.address("h1")
    r2 = stage.open("r2", "h2", mode="router", listen="tcp/[::]:7447", connect=at)
    both = [at, stage.address("h2")]
    a = stage.open("a", "h3", mode="client", connect=both)
    b = stage.open("b", "h2", mode="client", connect=stage.address("h2"))
    assert stage.wait(lambda: len(a.links()) == 1)
    first, second = (r1, r2) if a.links() == [r1.id()] else (r2, r1)
    if first is r2:
        return
    _show_token(a, b)
    first.kill()
    a.expect("links", gives=[second.id()])
    b.watch("later", "u")
    a.token("u")
    b.expects("later", "+u")
    # A busy second router may hear of the move before it hears of the end of the first one.
    assert stage.wait(lambda: b.events("seen") in (["+t"], ["+t", "-t", "+t"])), b.events("seen")
    b.expect("living", "t", gives=["t"])


@scenario
def a_restarted_router_gets_its_clients_back(stage: Stage) -> None:
    hub, a, b = _star(stage)
    b.watch("seen", "t")
    b.subscriber("in", "k")
    a.publisher("k")
    a.token("t")
    b.expects("seen", "+t")
    hub.kill()
    b.expects("seen", "+t", "-t")
    stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    b.expects("seen", "+t", "-t", "+t")
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_peer_reaches_a_client_of_a_router(stage: Stage) -> None:
    hub, a, b = _star(stage)
    c = stage.open("c", "h1")
    c.expect("links", gives=[hub.id()])
    c.watch("seen", "t/*")
    c.subscriber("in", "k")
    a.token("t/a")
    a.publisher("k")
    c.expects("seen", "+t/a")
    _show_token(c, b, "t/c")
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    c.expects("in", "k=x")


@scenario
def two_peers_beside_a_router_get_each_message_once(stage: Stage) -> None:
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.expect("links", gives=sorted([hub.id(), b.id()]))
    b.expect("links", gives=sorted([hub.id(), a.id()]))
    b.subscriber("in", "k")
    b.queryable("q", "q", "yes")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    for number in range(10):
        a.put("k", str(number))
    b.expects("in", *(f"k={number}" for number in range(10)))
    a.expect("ask", "q", gives=["q=yes"])


@scenario
def a_router_does_not_serve_two_peers_that_never_met(stage: Stage) -> None:
    _set_ways(stage, "h1", "h2", are_open=False)
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    c = stage.open("c", "h3", mode="client", connect=stage.address("h3"))
    a.expect("links", gives=[hub.id()])
    b.expect("links", gives=[hub.id()])
    a.token("t/a")
    c.token("t/c")
    b.expect("living", "t/*", gives=["t/c"])
    _subscribe(c, b)
    a.publisher("k")
    assert a.heard("k") is False


@scenario
def a_peer_beside_two_routers_is_served_twice_by_one(stage: Stage) -> None:
    # What the peer sends reaches the clients of one router also by the other: so does Zenoh 1.10.
    r1 = stage.open("r1", "h1", mode="router", listen="tcp/[::]:7447")
    at = stage.address("h1")
    r2 = stage.open("r2", "h2", mode="router", listen="tcp/[::]:7447", connect=at)
    peer = stage.open("peer", "h3")
    beside = {
        r1: stage.open("c1", "h1", mode="client", connect=at),
        r2: stage.open("c2", "h2", mode="client", connect=stage.address("h2")),
    }
    peer.expect("links", gives=sorted([r1.id(), r2.id()]))
    r1.expect("links", gives=sorted([peer.id(), r2.id(), beside[r1].id()]))
    r2.expect("links", gives=sorted([peer.id(), r1.id(), beside[r2].id()]))
    serving = max(beside, key=lambda router: int(router.id(), 16).to_bytes(16, "little"))
    once, twice = beside.pop(serving), beside.popitem()[1]
    for client, name in ((once, "once"), (twice, "twice")):
        client.subscriber("in", "k/peer")
        client.watch("seen", "t")
        client.queryable("q", f"q/{name}", name)
        client.publisher("k/client")
    peer.subscriber("in", "k/client")
    peer.queryable("q", "q/peer", "peer")
    peer.publisher("k/peer")
    peer.token("t")
    # From then on one router alone passes on; before, it is also the other one.
    peer.expect(
        "ask", "q/*", gives=["q/once=once", "q/peer=peer", "q/twice=twice", "q/twice=twice"]
    )
    for client in (once, twice):
        client.expects("seen", "+t")
        client.expect("ask", "q/peer", gives=["q/peer=peer"])
        client.expect("heard", "k/client", gives=True)
    peer.expect("heard", "k/peer", gives=True)
    peer.put("k/peer", "x")
    once.expects("in", "k/peer=x")
    twice.expects("in", "k/peer=x", "k/peer=x")
    once.put("k/client", "1")
    peer.expects("in", "k/client=1")
    twice.put("k/client", "2")
    peer.expects("in", "k/client=1", "k/client=2")


@scenario
def a_router_does_not_serve_two_peers_that_lost_each_other(stage: Stage) -> None:
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    a, b = stage.open("a", "h1"), stage.open("b", "h2")
    a.expect("links", gives=sorted([hub.id(), b.id()]))
    b.expect("links", gives=sorted([hub.id(), a.id()]))
    _subscribe(a, b)
    _set_ways(stage, "h1", "h2", are_open=False)
    a.expect("links", gives=[hub.id()])
    b.expect("links", gives=[hub.id()])
    a.expect("heard", "k", gives=False)
    a.put("k", "lost")
    _set_ways(stage, "h1", "h2", are_open=True)
    a.expect("links", gives=sorted([hub.id(), b.id()]))
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "k=x")


def _set_ways(stage: Stage, one: str, other: str, *, are_open: bool) -> None:
    stage.set_way(one, other, is_open=are_open)
    stage.set_way(other, one, is_open=are_open)


@scenario
def a_namespace_crosses_routers(stage: Stage) -> None:
    hub = stage.open("hub", "h3", mode="router", listen="tcp/[::]:7447")
    at = stage.address("h3")
    a = stage.open("a", "h1", mode="client", connect=at, namespace="robot7")
    b = stage.open("b", "h2", mode="client", connect=at)
    b.expect("links", gives=[hub.id()])
    b.subscriber("in", "robot7/k")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "robot7/k=x")


@scenario
def a_client_reaches_its_router_over_udp(stage: Stage) -> None:
    hub = stage.open("hub", "h3", mode="router", listen="udp/[::]:7447")
    at = stage.address("h3", protocol="udp")
    a = stage.open("a", "h1", mode="client", connect=at)
    b = stage.open("b", "h2", mode="client", connect=at)
    a.expect("links", gives=[hub.id()])
    b.watch("seen", "t")
    b.subscriber("in", "k")
    a.publisher("k")
    a.token("t")
    b.expects("seen", "+t")
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "k=x")
    a.kill()
    b.expects("seen", "+t", "-t")


# Hosts that hear nothing, say nothing, or move


@scenario
def a_deaf_host_is_lost_at_both_ends_and_comes_back(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b)
    stage.set_deaf("h2", deaf=True)
    a.expect("links", gives=[])
    b.expect("links", gives=[])
    stage.set_deaf("h2", deaf=False)
    a.expect("links", gives=[b.id()])
    b.expects("seen", "+t", "-t", "+t")


@scenario
def a_mute_host_is_lost_at_both_ends_and_comes_back(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b)
    stage.set_mute("h1", mute=True)
    b.expect("links", gives=[])
    a.expect("links", gives=[])
    stage.set_mute("h1", mute=False)
    a.expect("links", gives=[b.id()])
    b.expects("seen", "+t", "-t", "+t")


@scenario
def hosts_with_a_way_in_one_direction_lose_each_other(stage: Stage) -> None:
    a, b = _pair(stage)
    c = stage.open("c", "h3")
    c.expect("links", gives=sorted([a.id(), b.id()]))
    _show_token(a, b)
    stage.set_way("h1", "h2", is_open=False)
    b.expects("seen", "+t", "-t")
    a.expect("links", gives=[c.id()])
    stage.set_way("h1", "h2", is_open=True)
    b.expects("seen", "+t", "-t", "+t")
    a.expect("links", gives=sorted([b.id(), c.id()]))


@scenario
def a_query_of_a_deaf_host_ends(stage: Stage) -> None:
    a, b = _pair(stage)
    a.silent_queryable("q", "q")
    b.expect("served", "q", gives=True)
    stage.set_deaf("h1", deaf=True)
    b.ask_later("asked", "q", 60.0)
    b.expects("asked", "end")


@scenario
def a_host_with_another_address_is_met_again(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b)
    stage.roam("h1")
    b.expects("seen", "+t", "-t", "+t")
    a.expect("links", gives=[b.id()])


@scenario
def a_client_with_another_address_finds_its_router_again(stage: Stage) -> None:
    hub, a, b = _star(stage)
    _show_token(a, b)
    stage.roam("h1")
    b.expects("seen", "+t", "-t", "+t")
    a.expect("links", gives=[hub.id()])


# Meeting without multicast


@scenario
def peers_without_multicast_meet_at_an_endpoint(stage: Stage) -> None:
    stage.set_multicast("h2", on=False)
    a = stage.open("a", "h1", listen="tcp/[::]:7448")
    b = stage.open("b", "h2", connect=stage.address("h1", 7448))
    a.expect("links", gives=[b.id()])
    b.expect("links", gives=[a.id()])


@scenario
def peers_without_multicast_are_introduced_by_a_third(stage: Stage) -> None:
    for host in ("h1", "h2", "h3"):
        stage.set_multicast(host, on=False)
    a = stage.open("a", "h1", listen="tcp/[::]:7448")
    at = stage.address("h1", 7448)
    b = stage.open("b", "h2", connect=at)
    c = stage.open("c", "h3", connect=at)
    b.expect("links", gives=sorted([a.id(), c.id()]))
    c.expect("links", gives=sorted([a.id(), b.id()]))


@scenario
def peers_without_multicast_or_endpoint_stay_apart(stage: Stage) -> None:
    stage.set_multicast("h2", on=False)
    a = stage.open("a", "h1")
    b = stage.open("b", "h2")
    c = stage.open("c", "h1")
    a.expect("links", gives=[c.id()])
    assert b.links() == []


# Congestion


@scenario
def a_congested_link_drops_messages_and_recovers(stage: Stage) -> None:
    a, b = _pair(stage)
    stage.set_rate("h1", 2_000_000)
    b.flooded("in", "k")
    a.publisher("k")
    a.expect("heard", "k", gives=True)
    a.flood("k", 400, 50_000)

    def has_recovered() -> bool:
        a.put("k", "last")
        return "last" in b.events("in")

    assert stage.wait(has_recovered)
    numbers = [int(each) for each in b.events("in") if each != "last"]
    assert 0 < len(numbers) < 400 and numbers == sorted(numbers)


@scenario
def a_congested_link_delays_retained_messages(stage: Stage) -> None:
    a, b = _pair(stage)
    stage.set_rate("h1", 2_000_000)
    b.flooded("in", "k")
    a.retained_publisher("k")
    a.expect("heard", "k", gives=True)
    a.flood("k", 100, 50_000)
    b.expects("in", *map(str, range(100)))


@scenario
def an_urgent_message_overtakes_others(stage: Stage) -> None:
    a, b = _pair(stage)
    stage.set_rate("h1", 2_000_000)
    b.flooded("in", "k/*")
    a.publisher("k/images")
    a.retained_publisher("k/urgent")
    a.expect("heard", "k/images", gives=True)
    a.expect("heard", "k/urgent", gives=True)

    def overtakes(number: int) -> bool:
        a.flood("k/images", 400, 50_000)
        a.put("k/urgent", f"urgent{number}")

        def has_ended() -> bool:
            a.put("k/images", f"end{number}")
            return {f"urgent{number}", f"end{number}"} <= set(b.events("in"))

        assert stage.wait(has_ended)
        events = b.events("in")
        after = events[events.index(f"urgent{number}") + 1 : events.index(f"end{number}")]
        return any(each.isdigit() for each in after)

    # Where the host of the test is busy, all images have arrived before the urgent message is sent.
    assert any(overtakes(number) for number in range(10))


@scenario
def a_link_that_takes_nothing_more_is_closed(stage: Stage) -> None:
    a, b = _pair(stage)
    _show_token(a, b)
    b.flooded("in", "k")
    a.retained_publisher("k")
    a.expect("heard", "k", gives=True)
    stage.set_rate("h1", 1000)
    a.flood("k", 200, 50_000)
    b.expects_all("seen", "-t")


# Apart for a while


@scenario
def processes_of_an_unplugged_host_keep_their_link(stage: Stage) -> None:
    a, b = stage.open("a", "h1"), stage.open("b", "h1")
    c = stage.open("c", "h2")
    b.expect("links", gives=sorted([a.id(), c.id()]))
    b.subscriber("in", "k")
    b.watch("seen", "t")
    a.publisher("k")
    a.token("t")
    b.expects("seen", "+t")
    stage.set_cable("h1", plugged=False)
    b.expect("links", gives=[a.id()])
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "k=x")
    b.expects("seen", "+t")


@scenario
def a_router_of_an_unplugged_host_serves_its_clients(stage: Stage) -> None:
    hub, _, c = _star(stage)
    a = stage.open("a", "h3", mode="client", connect=stage.address("h3"))
    b = stage.open("b", "h3", mode="client", connect=stage.address("h3"))
    stage.set_cable("h3", plugged=False)
    hub.expect("links", gives=sorted([a.id(), b.id()]))
    c.expect("links", gives=[])
    a.queryable("q", "q", "yes")
    b.expect("ask", "q", gives=["q=yes"])


@scenario
def a_message_of_a_short_failure_is_late(stage: Stage) -> None:
    a, b = _pair(stage)
    _subscribe(a, b)
    a.put("k", "1")
    stage.set_cable("h1", plugged=False)
    a.put("k", "2")
    stage.set_cable("h1", plugged=True)
    a.put("k", "3")
    b.expects("in", "k=1", "k=2", "k=3")


@scenario
def a_message_sent_while_apart_is_lost(stage: Stage) -> None:
    a, b = _pair(stage)
    _subscribe(a, b)
    stage.set_cable("h1", plugged=False)
    a.expect("links", gives=[])
    a.expect("heard", "k", gives=False)
    a.put("k", "lost")
    stage.set_cable("h1", plugged=True)
    a.expect("heard", "k", gives=True)
    a.put("k", "x")
    b.expects("in", "k=x")


@scenario
def a_retained_message_sent_while_apart_comes_when_together(stage: Stage) -> None:
    a, b = _pair(stage)
    b.retained_subscriber("in", "k")
    a.retained_publisher("k")
    a.put("k", "1")
    b.expects("in", "k=1")
    stage.set_cable("h1", plugged=False)
    a.expect("links", gives=[])
    a.put("k", "2")
    stage.set_cable("h1", plugged=True)
    b.expects_all("in", "k=1", "k=2")


@scenario
def a_retained_message_comes_once_by_several_routers(stage: Stage) -> None:
    _, a, b = _line(stage, is_mesh=True)
    a.retained_publisher("k")
    a.put("k", "1")
    b.retained_subscriber("in", "k")
    b.expects("in", "k=1")
    a.put("k", "2")
    b.expects("in", "k=1", "k=2")
