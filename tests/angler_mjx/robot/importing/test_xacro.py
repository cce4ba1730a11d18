"""Expansion of xacro: the language, lines, packages, faults, and what expressions may do."""

import time

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.importing import expressions
from angler_mjx.robot.importing.packages import open_packages
from angler_mjx.robot.importing.xacro import expand_xacro
from angler_mjx.robot.importing.xml_tree import read_xml

from .written import line_of

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'


@pytest.fixture
def expand(tmp_path):
    """Return the children that a text expands to, as (tag, attributes)."""

    def expand(body, files=(), packages=(), **arguments):
        for name, text in dict(files).items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        path = tmp_path / "rov.xacro"
        path.write_text(HEAD + body + "</robot>")
        folders = open_packages(path, [tmp_path / name for name in packages])
        return expand_xacro(read_xml(path), folders, arguments).children

    return expand


def values(elements):
    return [element.attributes.get("v", element.text.strip()) for element in elements]


EXPRESSIONS = {
    "${1 + 2 * 3}": "7",
    "${7 / 2}": "3.5",
    "${2 ** 3 - 7 % 4}": "5",
    "${pi / 2}": "1.5707963267948966",
    "${math.sqrt(16)}": "4.0",
    "${radians(180)}": "3.141592653589793",
    "a${1}b${'c'}": "a1bc",
    "$${x}": "${x}",
    "${1 if 2 > 1 and not False else 0}": "1",
    "${[1, 2, 3][-1] + len('ab')}": "5",
    "${'a b'.split()[1]}": "b",
    "${{'k': 4}['k']}": "4",
    "${sum([x * x for x in range(4) if x != 2])}": "10",
    "${max(1, 2.5)}": "2.5",
    "$(eval 2 * 3)": "6",
}


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_expressions_are_those_of_python(expand, text):
    escaped = text.replace("<", "&lt;").replace(">", "&gt;")
    assert values(expand(f'<p v="{escaped}"/>')) == [EXPRESSIONS[text]]


def test_properties_are_evaluated_when_used_and_have_scopes(expand):
    body = """
      <xacro:property name="a" value="${2 * b}"/> <xacro:property name="b" value="3"/>
      <xacro:property name="b" default="9"/> <xacro:property name="c" default="9"/>
      <xacro:macro name="m"><xacro:property name="b" value="5"/>
        <xacro:property name="d" value="${b}" scope="parent"/> <p v="${b}"/></xacro:macro>
      <xacro:m/> <p v="${a} ${b} ${c} ${d}"/>"""
    assert values(expand(body)) == ["5", "6 3 9 5"]


def test_macros_take_defaults_blocks_and_outer_values(expand):
    body = """
      <xacro:property name="side" value="left"/>
      <xacro:macro name="m" params="a b:=2 side:=^ gone:=^|7 text:='x y' *block **inner">
        <p v="${a} ${b} ${side} ${gone} ${text}"/>
        <xacro:insert_block name="block"/> <xacro:insert_block name="inner"/>
      </xacro:macro>
      <xacro:m a="${1 + 0}"><q v="${side}"/> <r><s v="1"/> <s v="2"/></r></xacro:m>
      <xacro:call macro="m" a="4" b="5" side="up"><q v="0"/> <r/></xacro:call>"""
    assert values(expand(body)) == ["1 2 left 7 x y", "left", "1", "2", "4 5 up 7 x y", "0"]


@pytest.mark.parametrize(
    ("text", "value"), [("'", "'"), ("''", ""), ("'7'", "7"), ("07.50", "7.5"), ("1_0", "1_0")]
)
def test_texts_of_properties_are_numbers_or_without_their_quotes(expand, text, value):
    assert values(expand(f'<xacro:property name="a" value="{text}"/><p v="${{a}}"/>')) == [value]


def test_conditions_choose(expand):
    body = """<xacro:arg name="sim" default="false"/>
      <xacro:if value="$(arg sim)"><p v="1"/></xacro:if>
      <xacro:unless value="$(arg sim)"><p v="2"/></xacro:unless>
      <xacro:if value="${1 == 1}"><p v="3"/></xacro:if>"""
    assert values(expand(body)) == ["2", "3"]
    assert values(expand(body, sim="true")) == ["1", "3"]


def test_a_macro_may_count_down(expand):
    body = """<xacro:macro name="n" params="k"><xacro:if value="${k > 0}"><p v="${k}"/>
      <xacro:n k="${k - 1}"/></xacro:if></xacro:macro> <xacro:n k="3"/>"""
    assert values(expand(body)) == ["3", "2", "1"]


def test_includes_are_relative_or_of_packages_and_yaml_is_read(expand):
    files = {
        "parts/one.xacro": HEAD + '<xacro:include filename="two.xacro"/></robot>',
        "parts/two.xacro": HEAD + '<xacro:property name="k" value="4"/></robot>',
        "other/package.xml": "<package><name>far</name></package>",
        "other/x.xacro": HEAD + '<p v="${k}"/></robot>',
        "numbers.yaml": "water: {density: 1025}\nlist: [1, 2.5]\n",
    }
    body = """<xacro:include filename="parts/one.xacro"/>
      <xacro:include filename="$(find far)/x.xacro"/>
      <xacro:property name="y" value="${xacro.load_yaml('numbers.yaml')}"/>
      <p v="${y['water']['density'] + y.list[1]}"/>"""
    assert values(expand(body, files)) == ["4", "1027.5"]


def test_lines_are_those_of_the_text_and_of_the_call(expand):
    body = '<xacro:macro name="m">\n  <p/>\n</xacro:macro>\n<xacro:m/>\n'
    (element,) = expand(body)
    assert element.location.line == 3
    assert element.location.caller.line == 5
    assert "rov.xacro:3 (called at" in str(element.location)


FAULTS = {
    "macro cycle": (
        '<xacro:macro name="a"><xacro:b/></xacro:macro>'
        '<xacro:macro name="b"><xacro:a/></xacro:macro>\n<xacro:a/>',
        "expands itself without end",
    ),
    "include cycle": ('\n<xacro:include filename="rov.xacro"/>', "break the cycle"),
    "property cycle": (
        '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/>'
        '<p v="${a}"/>',
        "defined by itself",
    ),
    "unknown macro": ("<xacro:wheel/>", "no macro 'wheel'"),
    "unknown name": ('<p v="${mass}"/>', "'mass' is not defined"),
    "unknown argument": ('<p v="$(arg sim)"/>', "--xacro-args sim:=VALUE"),
    "unknown package": ('<xacro:include filename="$(find gone)/a.xacro"/>', "--packages"),
    "missing include": ('<xacro:include filename="gone.xacro"/>', "there is no file"),
    "include outside": ('<xacro:include filename="../../secret.xacro"/>', "lies outside"),
    "absolute include": ('<xacro:include filename="/etc/passwd"/>', "lies outside"),
    "environment": ('<p v="$(env HOME)"/>', "only arg, find"),
    "parameter": ('<xacro:macro name="m" params="a"/><xacro:m a="1" c="2"/>', "no parameter 'c'"),
    "missing parameter": ('<xacro:macro name="m" params="a"/><xacro:m/>', "needs 'a'"),
    "missing block": ('<xacro:macro name="m" params="*a"/><xacro:m/>', "needs a block"),
    "spare block": ('<xacro:macro name="m"/><xacro:m><p/></xacro:m>', "no further block"),
    "unknown block": ('<xacro:insert_block name="a"/>', "no block 'a'"),
    "condition": ('<xacro:if value="perhaps"/>', "true or false"),
    "bracket": ('<p v="${1"/>', "not closed"),
    "division": ('<p v="${1 / 0}"/>', "division by zero"),
    "yaml": ("<p v=\"${load_yaml('/etc/passwd')}\"/>", "lies outside"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_names_file_line_and_remedy(expand, fault):
    body, part = FAULTS[fault]
    with pytest.raises(ConfigError) as error:
        expand(body)
    text = str(error.value)
    assert part in text
    assert "rov.xacro:" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__.__bases__",
        "'a'.__class__",
        "open('/etc/passwd')",
        "eval('1')",
        "exec('1')",
        "(lambda: 1)()",
        "'a'.format(1)",
        "'%s' % 1",
        "9 ** 9 ** 9",
        "2 ** 3000 * 2 ** 1001",
        "2 ** 3999 + 2 ** 3999 + 2 ** 3999",
        "'a' * 10 ** 9",
        "[0] * 10 ** 9",
        "range(10 ** 9)",
        "list(range(10 ** 9))",
        "[[y for y in range(9999)] for x in range(9999)]",
        "[len([y for y in range(9999)]) for x in range(9999)]",
        "math.factorial(10 ** 6)",
        "[x for x in 5]",
        "str.mro()",
        "print(1)",
    ],
)
def test_expressions_reach_nothing_and_stay_small(text):
    start = time.process_time()
    with pytest.raises(expressions.ExpressionError):
        expressions.evaluate(text, {}.__getitem__, {})
    assert time.process_time() - start < 1


def test_numbers_may_have_4000_binary_digits():
    value = expressions.evaluate("2 ** 1999 * 2 ** 2000", {}.__getitem__, {})
    assert value == 1 << 3999


def test_lists_may_have_10_000_entries():
    value = expressions.evaluate("sum([x * x for x in range(10000)])", {}.__getitem__, {})
    assert value == 9999 * 10000 * 19999 // 6


def test_macros_that_multiply_are_stopped(expand):
    body = '<xacro:macro name="m0"><p/></xacro:macro>'
    for i in range(30):
        body += f'<xacro:macro name="m{i + 1}"><xacro:m{i}/><xacro:m{i}/></xacro:macro>'
    with pytest.raises(ConfigError, match="expands to more than"):
        expand(body + "<xacro:m30/>")


def test_3000_lines_take_less_than_two_seconds(bring):
    lines = ["<?xml version='1.0'?>", HEAD, '<xacro:property name="r" value="0.1"/>']
    lines.append(
        """<xacro:macro name="part" params="n x">
        <link name="part_${n}"><inertial><origin xyz="${x * r} ${sin(x)} 0"/><mass value="0.01"/>
        <inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial></link>
        <xacro:property name="before" value="${'part_' + str(n - 1) if n else 'thruster'}"/>
        <joint name="joint_${n}" type="fixed"><parent link="${before}"/>
        <child link="part_${n}"/></joint></xacro:macro>"""
    )
    lines += [
        '<link name="base"><inertial><mass value="9"/>',
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>',
        '<link name="thruster"/><joint name="t" type="fixed"><parent link="base"/>',
        '<child link="thruster"/></joint>',
    ]
    lines += [f'<xacro:part n="{i}"\n x="${{{i} / 700}}"\n/>\n' for i in range(750)]
    lines.append("</robot>")
    text = "\n".join(lines)
    assert text.count("\n") > 3000
    start = time.process_time()
    made = bring(text, "rov.xacro")
    assert time.process_time() - start < 2
    assert made.numbers["rigid_body"]["mass_kg"] == pytest.approx(9 + 7.5)


def test_the_list_of_a_xacro_names_lines_of_its_files(bring):
    body = """<xacro:arg name="mass" default="12"/>
      <xacro:include filename="urdf/base.xacro"/> <xacro:base mass="$(arg mass)"/>"""
    base = f"""{HEAD}<xacro:macro name="base" params="mass">
      <link name="base_link"><inertial><mass value="${{mass}}"/>
        <inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.2"/></inertial>
        <paint/></link>
      <link name="thruster"/>
      <joint name="t" type="fixed"><parent link="base_link"/><child link="thruster"/></joint>
      </xacro:macro></robot>"""
    text = HEAD + body + "</robot>"
    made = bring(text, "rov.xacro", files={"urdf/base.xacro": base}, arguments={"mass": "14"})
    assert made.trim.mass_kg == 14
    line = line_of(base, "<paint/>")
    assert made.noted("dropped", "<paint>", f"urdf/base.xacro:{line} (called at", "rov.xacro:3")


@pytest.mark.parametrize(
    "text", ["${" + "-" * 400 + "1}", "${" + "(" * 150 + "1" + ")" * 150 + "}"]
)
def test_deep_expressions_end_in_a_value_or_a_message(bring, text):
    with pytest.raises(ConfigError):
        bring(f'{HEAD}<link name="{text}"/></robot>', "rov.xacro")


def test_deep_macros_are_one_message(bring):
    body = '<xacro:macro name="m" params="k"><xacro:if value="${k > 0}">'
    body += "<a>" * 60 + '<xacro:m k="${k - 1}"/>' + "</a>" * 60
    with pytest.raises(ConfigError, match=r"rov\.xacro"):
        bring(f'{HEAD}{body}</xacro:if></xacro:macro><xacro:m k="30"/></robot>', "rov.xacro")
