"""The list of topics in the tab Data: its order, its robots, and its search."""

import re
from dataclasses import replace
from html import unescape
from typing import Any

import pytest

from tfbus.bus.graph import Endpoint, TopicInfo

pytest.importorskip("viser", reason="needs viser: the extra view")

from tfbus.view.panels.data import robots_of, topics_html
from tfbus.view.settings import TopicSettings, ViewSettings

CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"


def topics(*published: tuple[str, str, str]) -> dict[str, TopicInfo]:
    """Topics, each with its type and the node that publishes it."""
    return {
        name: TopicInfo(name, (Endpoint(node, type_),)) for name, type_, node in sorted(published)
    }


FLEET = topics(
    ("map_points", CLOUD, "/site/server"),
    ("camera/points", CLOUD, "/site/server"),
    ("robot2/scan", SCAN, "/site/robot2/lidar"),
    ("robot1/scan", SCAN, "/site/robot1/lidar"),
    ("robot1/front/points", CLOUD, "/site/robot1/lidar"),
    ("robot1/bridged", CLOUD, "/ros2"),
)


def shown(*named: str, **settings: Any) -> ViewSettings:
    """Settings with these topics ticked."""
    return ViewSettings(topics=tuple(map(TopicSettings, named)), **settings)


def lines(html: str) -> list[str]:
    """The headings and the topics of the list."""
    found = re.findall(r'<b[^>]*>(.*?)</b>|data-topic="(.*?)"', html)
    return [heading or topic for heading, topic in found]


def test_a_topic_is_of_the_robot_in_whose_namespace_it_is_published() -> None:
    """A folder of topics, as of a camera, is no robot; a bridge's topics are of those they name."""
    found = robots_of(FLEET)
    assert {topic: robot for topic, robot in found.items() if robot} == {
        "robot1/scan": "robot1",
        "robot1/front/points": "robot1",
        "robot1/bridged": "robot1",
        "robot2/scan": "robot2",
    }


def test_ticked_topics_come_first_then_robot_by_robot() -> None:
    """All by name."""
    html = topics_html(FLEET, shown("robot2/scan", "map_points"))
    assert lines(html) == [
        *("map_points", "robot2/scan", "camera/points"),
        *("robot1", "robot1/bridged", "robot1/front/points", "robot1/scan"),
    ]
    assert html.count("checked data-topic") == 2
    assert "2 of 6 drawn" in html


def test_a_group_has_a_box_and_its_topics_below() -> None:
    """Behind ticked ones of no group, ticked or not; its box is empty while it is hidden."""
    named = ("robot1/scan", "robot2/scan", "map_points")
    settings = shown(*named, hidden_groups=("lidars",))
    grouped = tuple(
        replace(each, group="lidars", shown=each.topic != "robot2/scan")
        if "scan" in each.topic
        else each
        for each in settings.topics
    )
    settings = replace(settings, topics=grouped)
    html = topics_html(FLEET, settings)
    assert lines(html) == [
        *("map_points", "lidars", "robot1/scan", "robot2/scan", "camera/points"),
        *("robot1", "robot1/bridged", "robot1/front/points"),
    ]
    [box] = re.findall(r"<input[^>]*data-group[^>]*>", html)
    assert "checked data" not in box
    assert html.count("checked data-topic") == 2
    assert "1 of 6 drawn" in html
    assert "checked data-group" in topics_html(FLEET, replace(settings, hidden_groups=()))
    assert lines(topics_html(FLEET, settings, "lidars")) == ["lidars", *named[:2]]


def test_topics_are_found_by_a_part_of_their_name_or_type() -> None:
    """In either case of letters; if there is none it says so."""
    assert lines(topics_html(FLEET, shown(), "SCAN")) == [
        *("robot1", "robot1/scan", "robot2", "robot2/scan")
    ]
    assert lines(topics_html(FLEET, shown(), "front")) == ["robot1", "robot1/front/points"]
    none = unescape(topics_html(FLEET, shown(), " wheel "))
    assert "No topic has 'wheel'" in none


def test_names_of_strangers_are_text() -> None:
    """Not HTML."""
    html = topics_html(topics(('<b>"x', CLOUD, "/<i>")), shown(), "<u>")
    html += topics_html(topics(('<b>"x', CLOUD, "/<i>")), shown())
    assert "<b>" not in html
    assert "<u>" not in html
    assert '&lt;b&gt;&quot;x"' in html
